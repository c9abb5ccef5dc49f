"""Model of a scanned ball on a smooth but uneven background.

Near the surface of a ball of radius R, blurred by a Gaussian of covariance S = diag(sz², sxy², sxy²),

    I(x) = out + b(x) + (in - out) / 2 · erfc( (r + t / 2r - R) / (√2 s) ),   r = |x - c|,
    s² = nᵀ S n along the radial direction n,   t = trace(S) - s²  (the curvature of the surface),

with a polynomial b that represents metal streaks across the neighbourhood.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

Array = NDArray[np.float64]

# order of the parameters: the centre (slice, row, column), then these, then the background coefficients
OUT, IN, SZ, SXY, RADIUS = 3, 4, 5, 6, 7
BALL = 8
SLOPE = slice(BALL, BALL + 3)


def polynomial(places: Array, degrees: Iterable[int]) -> Array:
    """All products (n, m) of `degrees` coordinates of `places` (n, 3), degree by degree."""
    chosen = [one for degree in degrees for one in combinations_with_replacement(range(3), degree)]
    columns = np.empty((len(places), len(chosen)))
    for number, axes in enumerate(chosen):
        columns[:, number] = places[:, axes[0]]
        for axis in axes[1:]:
            columns[:, number] *= places[:, axis]
    return columns


def intensities(points_mm: Array, unknowns: Array, background: Array) -> tuple[Array, Array]:
    """Intensities (n,) HU at points (n, 3) grid mm, and their derivatives (n, 8 + m) by the parameters.

    `background` (n, m) are the polynomial's terms at the points. The derivatives neglect that the blur
    varies with the direction from the centre and shifts the edge: both effects are small, and fits
    converge without them.
    """
    offsets = points_mm - unknowns[:3]
    r = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    n = offsets / r[:, None]
    variance_z, variance_xy = unknowns[SZ] ** 2, unknowns[SXY] ** 2
    along_z = n[:, 0] ** 2
    s2 = variance_xy + (variance_z - variance_xy) * along_z
    s = np.sqrt(s2)
    bend = (variance_z + 2 * variance_xy - s2) / (2 * np.maximum(r, unknowns[SXY]))
    u = (r + bend - unknowns[RADIUS]) / (np.sqrt(2.0) * s)
    cover = 0.5 * erfc(u)
    contrast = unknowns[IN] - unknowns[OUT]
    fall = contrast * np.exp(-(u**2)) / (np.sqrt(2.0 * np.pi) * s)  # -dI/dr
    derivatives = np.empty((len(r), len(unknowns)))
    derivatives[:, :3] = (fall * (1.0 - bend / r))[:, None] * n
    derivatives[:, OUT] = 1.0 - cover
    derivatives[:, IN] = cover
    # through u = d / (√2 s): du/ds = -u / s, with ds/dsz = sz n_z² / s and ds/dsxy = sxy (1 - n_z²) / s
    by_s = fall * np.sqrt(2.0) * u
    derivatives[:, SZ] = by_s * unknowns[SZ] * along_z / s
    derivatives[:, SXY] = by_s * unknowns[SXY] * (1.0 - along_z) / s
    derivatives[:, RADIUS] = fall
    derivatives[:, BALL:] = background
    return unknowns[OUT] + contrast * cover + background @ unknowns[BALL:], derivatives
