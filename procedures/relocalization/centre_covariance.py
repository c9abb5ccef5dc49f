"""Covariance of an outline's centre, from what the residuals of its rim show and what they cannot show.

Errors that neighbouring rays share (grain, the texture of a drape, edges of stains) are seen in the sums of
residuals over blocks of rays. Three errors leave no residual, because they shift the rim as the centre would:

- Film that is darker in the last fraction of a pixel, where light from beside the lens no longer reaches it,
  moves the edge inwards. The less the film stands out there, the farther: before a bright drape.
- Light from elsewhere, such as a lamp at the side, falls off towards the limb in its own way.
- Where the film is clipped, the edge moves outwards by a share of the blur, the more the brighter the film,
  and how bright it is cannot be seen.

They are not estimated, since edge and step of a ray share their noise. Their effect on the centre is added to
its covariance, with their usual size.

What hides part of the rim is out of focus, and dims the film for some degrees beside it. The edges there lie
inwards, at the ends of the arc, where they have the most leverage. How far the centre moves without these
rays is added too. That a rim is partly hidden matters in no other way: an arc cut out of the whole rims of
path-traced views leaves the stated error as honest as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.ellipse import EllipseFit, fit_ellipse
from ronna_hw.arrays import Array
from ronna_hw.robust_scale import median

BLOCKS = 15  # of the rim, 24 degrees each: longer than a grain, shorter than a shift of the centre
FITTED = 5  # parameters of an ellipse: so much of the block sums is lost in the fit
LEAST_BLOCK_SHARE = 0.3  # of the usual weight; a block with less is left out
USUAL_BLOCKS = 2.0  # of independent rays, which steady the ratio of a rim with few blocks
# Errors of one cycle per turn over those of a block: 1.8 on the simulated cameras, 1.6 on path-traced films;
# the hardware's films are unknown (U).
LONGEST_OVER_BLOCK = 1.8

SMOOTHING_RAYS = 10  # to either side
LOW_PERCENTILE, HIGH_PERCENTILE = 10.0, 95.0
LEAST_STEP_SHARE = 0.05  # of the median step
# Lamps 14 mm from the lens axis, 250 mm away, leave 0.1 px of a rim of 261 px unlit, on average.
RIM_WIDTH_PX = 0.10
SIDE_RIM_WIDTH_PX = 0.16  # of light from elsewhere; fitted to path-traced images (U)
OWN_EVENNESS = 1.1  # brightest over darkest film under the head's own lamps
CLIPPED_SHIFT_BLURS = 0.4  # from film that is barely clipped to film half again as bright
# Clipped film moves the edge by 0.7 blurs per natural unit of brightness. A lamp that lights the film of one
# side only does so with half of that in one cycle per turn.
UNEVEN_SHIFT_BLURS = 0.3
SHORTEST_GAP_RAYS = 5  # in a row without rim; the loss of one ray by noise takes its neighbours with it
# To either side of a gap, 7 degrees. Beside a sheet whose edge is blurred by 1.5 to 15 px, path-traced rims
# lie 0.06 px inwards, 0.04 px after two rays and less than 0.02 px after four, on average.
DIMMED_RAYS = 6


@dataclass(frozen=True)
class RimLight:
    """Grey levels at the rays of a fit (n,), and what share of the film at each is clipped.

    `ray` numbers the rays of the fit among all `rays` around the rim.
    """

    ray: NDArray[np.intp]
    rays: int
    dark_grey: Array
    step_grey: Array
    clipped: Array
    blur_px: float

    @cached_property
    def smooth_step_grey(self) -> Array:
        """Step (n,), averaged over neighbouring rays, and never near zero."""
        return np.maximum(self.smooth(self.step_grey), LEAST_STEP_SHARE * median(self.step_grey))

    @cached_property
    def smooth_dark_grey(self) -> Array:
        """Background (n,), averaged over neighbouring rays."""
        return self.smooth(self.dark_grey)

    @cached_property
    def smooth_clipped(self) -> Array:
        """Clipped share (n,), averaged over neighbouring rays."""
        return self.smooth(self.clipped)

    @property
    def film_ratio(self) -> float:
        """Brightest over darkest film around the rim."""
        film = self.smooth_dark_grey + self.smooth_step_grey
        return float(np.percentile(film, HIGH_PERCENTILE) / max(np.percentile(film, LOW_PERCENTILE), 1.0))

    @cached_property
    def half_way_grey(self) -> float:
        """Mid-level between the background and the film where that is darkest."""
        film_over_dark = np.percentile(self.step_grey, LOW_PERCENTILE)
        return float(median(self.dark_grey) + 0.5 * film_over_dark)

    def smooth(self, values: Array) -> Array:
        """Average values (n,) over neighbouring rays of the fit."""
        around = np.zeros((2, self.rays))
        around[:, self.ray] = values, np.ones(len(values))
        ends = around[:, -SMOOTHING_RAYS - 1 :], around[:, :SMOOTHING_RAYS]
        wrapped = np.concatenate([ends[0], around, ends[1]], axis=1).cumsum(axis=1)
        sums = wrapped[:, 2 * SMOOTHING_RAYS + 1 :] - wrapped[:, : -2 * SMOOTHING_RAYS - 1]
        return np.asarray((sums[0] / np.maximum(sums[1], 1.0))[self.ray])


def centre_covariance(fit: EllipseFit, light: RimLight) -> Array:
    """Return the covariance (2, 2) of the centre in px^2."""
    shifts = [
        *_rim_shifts_px(fit, light),
        clipped_shift_px(fit, light),
        *_cover_shifts_px(fit, light),
    ]
    hidden = sum((np.outer(shift, shift) for shift in shifts), np.zeros((2, 2)))
    unseen_px = UNEVEN_SHIFT_BLURS * light.blur_px * _uneven_light(light) * float(np.mean(light.clipped))
    shared = _ratio_of_shared(fit, light) * fit.centre_covariance_px2
    return np.asarray(shared + hidden + unseen_px**2 * np.eye(2))


def clipped_shift_px(fit: EllipseFit, light: RimLight) -> Array:
    """Return the shift (2,) of the centre in px by a rim that is clipped on one side only."""
    shift = fit.centre_gain @ (CLIPPED_SHIFT_BLURS * light.blur_px * light.smooth_clipped)
    return np.asarray(shift)


def _cover_shifts_px(fit: EllipseFit, light: RimLight) -> list[Array]:
    """Return how far (2,) the centre moves without the rays beside each gap in the rim, in px."""
    shifts: list[Array] = []
    for before, after in _gaps(light):
        beside = np.minimum((before - light.ray) % light.rays, (light.ray - after) % light.rays) < DIMMED_RAYS
        without = fit_ellipse(fit.points_px[~beside], fit.ellipse, rough_start=False)
        if without is not None:
            shifts.append(np.subtract(without.ellipse.centre_px, fit.ellipse.centre_px))
    return shifts


def _gaps(light: RimLight) -> list[tuple[int, int]]:
    """Return the rays before and after each gap in the rim."""
    following = np.roll(light.ray, -1)
    lost = (following - light.ray) % light.rays - 1
    ends = np.flatnonzero(lost >= SHORTEST_GAP_RAYS)
    return [(int(light.ray[end]), int(following[end])) for end in ends]


def _rim_shifts_px(fit: EllipseFit, light: RimLight) -> tuple[Array, Array]:
    """Return the shifts (2,) of the centre by a dark edge of the film, in its own and in other light."""
    film = light.smooth_dark_grey + light.smooth_step_grey
    own = OWN_EVENNESS * float(np.percentile(film, LOW_PERCENTILE))
    over_step = fit.centre_gain / light.smooth_step_grey
    return RIM_WIDTH_PX * over_step @ film, SIDE_RIM_WIDTH_PX * over_step @ np.maximum(film - own, 0.0)


def _uneven_light(light: RimLight) -> float:
    """Return how uneven the light on a clipped film may be, relative, from how it is on the background."""
    dark = light.smooth_dark_grey
    return float((np.percentile(dark, HIGH_PERCENTILE) - dark.min()) / median(light.step_grey))


def _ratio_of_shared(fit: EllipseFit, light: RimLight) -> float:
    """Return the variance of the longest errors around the rim over that of independent rays."""
    block = light.ray * BLOCKS // light.rays
    sums = np.bincount(block, fit.weights * fit.residual_px, BLOCKS)
    expected = fit.sigma_px**2 * np.bincount(block, fit.weights**2, BLOCKS)
    kept = expected > LEAST_BLOCK_SHARE * np.median(expected[expected > 0.0])
    free = max(0, int(kept.sum()) - FITTED)
    seen = float(np.sum(sums[kept] ** 2 / expected[kept])) if free else 0.0
    return LONGEST_OVER_BLOCK * (USUAL_BLOCKS + seen) / (USUAL_BLOCKS + free)
