"""Covariance of an outline's centre: what its residuals show, and what they cannot.

Residuals that neighbouring rays share (grain, texture of a drape, edges of stains) are seen in the sums over
blocks of rays. Two errors leave no residual, because they move the rim as a shift of the centre would:

- Film that is darker in the last fraction of a pixel, where a lamp beside the lens no longer reaches it, moves
  the edge inwards, and the further the less the film stands out: before a bright drape, or where a lamp from
  the side does not reach. A width unknown by some tenth of a pixel is assumed, constant around the rim.
- A clipped film hides how bright it is: the edge moves outwards by a share of the blur.

Neither is estimated. Their effect on the centre is, and is added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.ellipse import EllipseFit

Array = NDArray[np.float64]

BLOCKS = 15  # of the rim: 24 degrees each, longer than grain and stains, shorter than a shift
FITTED = 5  # parameters of an ellipse, which the block sums cannot show
LEAST_BLOCK_SHARE = 0.3  # of the usual weight of a block; one with less is left out
# Neighbouring rays share grain, uneven light and the edges of stains, so they carry less information than
# independent ones. This factor is right on the simulated cameras' images; films and lights of the hardware
# are unknown (U), so it counts only as much as this many blocks.
USUAL_SHARED_ERRORS = 2.3
USUAL_BLOCKS = 10.0

SMOOTHING_RAYS = 10  # to either side
LOW_PERCENTILE = 10.0  # of the film's brightness around the rim: where only the lamps at the lens reach it
LEAST_STEP_SHARE = 0.05  # of the median step
# A ring of lamps 14 mm from the axis, 250 mm away, leaves 0.1 px of a rim of 260 px half lit.
RIM_WIDTH_PX = 0.12
LAMP_RIM_WIDTH_PX = 0.12  # of the light that others cast on the film
OWN_LIGHT_EVENNESS = 1.25
CLIPPED_SHIFT_BLURS = 0.5  # from film that is barely clipped to film twice as bright
CLIPPED_EVENNESS = 0.05  # of the film's brightness around a clipped rim, besides what the drape's light casts


@dataclass(frozen=True)
class RimLight:
    """Grey levels at the rays of a fit (n,), the share of each that is clipped, and the blur."""

    ray: NDArray[np.intp]  # number of each ray, of `rays` around the rim
    rays: int
    dark_grey: Array
    step_grey: Array
    clipped: Array
    blur_px: float


def centre_covariance(fit: EllipseFit, light: RimLight) -> tuple[Array, float]:
    """Return the covariance (2, 2) of the centre in px^2, and the sigma in px that clipping has in it."""
    centre_gain = fit.centre_gain
    shared = _shared_errors(fit, light)
    total = shared * fit.centre_covariance_px2
    step = np.maximum(_smooth(light, light.step_grey), LEAST_STEP_SHARE * np.median(light.step_grey))
    dark = _smooth(light, light.dark_grey)
    film = dark + step
    own = OWN_LIGHT_EVENNESS * float(np.percentile(film, LOW_PERCENTILE))
    for width_px, grey in ((RIM_WIDTH_PX, film), (LAMP_RIM_WIDTH_PX, np.maximum(film - own, 0.0))):
        shift = centre_gain @ (width_px * grey / step)
        total = total + np.outer(shift, shift)
    clipped = _smooth(light, light.clipped)
    shift = centre_gain @ (CLIPPED_SHIFT_BLURS * light.blur_px * clipped)
    unevenness = np.hypot(CLIPPED_EVENNESS, 0.5*np.median(light.dark_grey) / np.median(light.step_grey))
    common = (CLIPPED_SHIFT_BLURS * light.blur_px * unevenness * float(np.mean(clipped))) ** 2
    clipping = np.outer(shift, shift) + common * np.eye(2)
    return total + clipping, float(np.sqrt(np.trace(clipping) / 2.0))


def _shared_errors(fit: EllipseFit, light: RimLight) -> float:
    """Return the ratio of the variance of block sums to that of as many independent rays."""
    block = light.ray * BLOCKS // light.rays
    sums = np.bincount(block, fit.weights * fit.residual_px, BLOCKS)
    expected = fit.sigma_px**2 * np.bincount(block, fit.weights**2, BLOCKS)
    kept = expected > LEAST_BLOCK_SHARE * np.median(expected[expected > 0])
    free = int(kept.sum()) - FITTED
    if free < 1:
        return USUAL_SHARED_ERRORS
    seen = float(np.sum(sums[kept] ** 2 / expected[kept]))
    return (USUAL_BLOCKS * USUAL_SHARED_ERRORS + seen) / (USUAL_BLOCKS + free)


def _smooth(light: RimLight, values: Array) -> Array:
    """Average over the neighbouring rays of the fit."""
    around = np.zeros((2, light.rays))
    around[0, light.ray], around[1, light.ray] = values, 1.0
    wrapped = np.pad(around, ((0, 0), (SMOOTHING_RAYS + 1, SMOOTHING_RAYS)), mode="wrap").cumsum(axis=1)
    sums = wrapped[:, 2 * SMOOTHING_RAYS + 1 :] - wrapped[:, : -2 * SMOOTHING_RAYS - 1]
    return np.asarray((sums[0] / np.maximum(sums[1], 1.0))[light.ray])
