"""Course of a line along the skin: what its centres have in common, more exact than each of them.

Speckle is new after every grain, while skin is smooth. A cubic smoothing spline (Green and Silverman 1994)
uses both; its roughness follows from restricted likelihood, so that a nose is smoothed less than a forehead.
At corners, such as the wing of a nose, the course may bend freely.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from ronna_hw.arrays import Array
from ronna_hw.robust_scale import MAD_TO_SIGMA, median

FEWEST = 5  # centres of a course
ROUGHNESS = 4.0 ** np.arange(-8, 6)  # of the course against the noise: hypotheses, equally likely
CORNER_SIGMAS = 6.0  # of the usual bend: a bend that is none of the smooth course
FREE = 1e6  # roughness of a corner relative to that of the course
PRIOR_CENTRES = 8.0  # that the stated variances count as, when the residuals correct their scale


def smooth_course(along: Array, across: Array, variance: Array) -> tuple[Array, Array]:
    """Return places (n,) across the line and their variances, given independent ones in order along it."""
    if len(along) < FEWEST:
        return across, variance
    step = np.diff(along)
    step = step / step.mean()
    bends = np.zeros((len(along), len(along) - 2))  # second differences
    inner = np.arange(len(along) - 2)
    bends[inner, inner] = 1.0 / step[:-1]
    bends[inner + 1, inner] = -1.0 / step[:-1] - 1.0 / step[1:]
    bends[inner + 2, inner] = 1.0 / step[1:]
    course = np.diag((step[:-1] + step[1:]) / 3.0)
    course[inner[:-1], inner[1:]] = course[inner[1:], inner[:-1]] = step[1:-1] / 6.0
    noise = bends.T @ (variance[:, None] * bends)
    bend = bends.T @ across
    course[inner, inner] *= np.where(_is_corner(bend / np.sqrt(np.diagonal(noise))), FREE, 1.0)
    size, axes = eigh(course, noise, check_finite=False, overwrite_a=True, overwrite_b=True)
    seen = axes.T @ bend
    share = 1.0 / (ROUGHNESS[:, None] * np.maximum(size, 0.0) * np.mean(variance) + 1.0)  # of the noise
    square = PRIOR_CENTRES + share @ seen**2
    logs = 0.5 * np.log(share).sum(axis=1) - 0.5 * (PRIOR_CENTRES + len(inner)) * np.log(square)
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    gain = variance[:, None] * (bends @ axes)
    steps = gain @ (share * seen).T  # (n, hypotheses)
    mean = steps @ weight
    scale = weight @ square / (PRIOR_CENTRES + len(inner))
    left = scale * (variance - gain**2 @ (weight @ share))
    return across - mean, left + (steps - mean[:, None]) ** 2 @ weight


def _is_corner(bend: Array) -> Array:
    """Return whether bends (m,), in units of their noise, are out of all proportion to the usual ones."""
    off = np.abs(bend - median(bend))
    return np.asarray(off > CORNER_SIGMAS * max(MAD_TO_SIGMA * median(off), 1.0))
