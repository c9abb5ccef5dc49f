"""Second estimator of a sphere's centre: a blurred ball fitted to the voxels themselves.

The parameters are the centre, both intensities, both blurs, the radius and the background. Voxels near metal
are excluded. A robust fit, insensitive to outliers (post, skin), finds what does not belong to the ball; a
fit with a model of noise and streaks then makes full use of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from procedures.imaging.region import Region
from procedures.imaging.sphere_centre.ball_model import BALL, IN, OUT, RADIUS
from procedures.imaging.sphere_centre.ball_voxels import MIN_VOXELS, BallVoxels
from procedures.imaging.sphere_centre.stretch import Stretch
from procedures.imaging.sphere_centre.whitened_ball import fit_whitened

Array = NDArray[np.float64]

METAL_HU = 900.0
METAL_REACH_MM = 2.2  # reach of blur from metal
FIT_MARGIN_MM = 2.25  # voxels up to this far outside the sphere are used
HIDDEN_DEPTH_MM = 1.5  # under a hidden surface; its blur does not reach deeper
HIDDEN_REACH = 0.14  # rad; a ray represents its surroundings, neighbours are 0.18 apart
START_BLUR_MM = 0.42  # sigma of a typical reconstruction kernel


@dataclass(frozen=True, eq=False)
class BlurredBall:
    """A fitted ball. Centre and covariance in grid mm (slice, row, column), intensities in HU."""

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    noise_hu: float
    metal_share: float  # part of the sphere's surface too close to metal to be used
    streak_hu: float  # typical size, at the surface, of the terms by which streaks bend the background
    contrast_hu: float
    stretch: Stretch  # where the surface borders on the outside


@dataclass(frozen=True, eq=False)
class RoughBall:
    """Result of the robust fit: the voxels used, and all parameters."""

    voxels: BallVoxels
    unknowns: Array
    metal_share: float

    @property
    def contrast_hu(self) -> float:
        """Contrast between ball and surroundings."""
        return abs(float(self.unknowns[IN] - self.unknowns[OUT]))

    @property
    def uneven(self) -> float:
        """Slope and bend of the background over a radius, as a share of the contrast."""
        return float(np.linalg.norm(self.unknowns[BALL:])) / self.contrast_hu

    def refined(self, hidden_ways: Array, *, most_streaks: float = np.inf) -> BlurredBall | None:
        """The best fit nearby; None without one, or if streaks bend more than that part of the contrast.

        `hidden_ways` (n, 3): directions without information about the shape.
        """
        fitted = fit_whitened(
            self.voxels.without_outliers(self.unknowns),
            self.unknowns,
            most_streak_hu=most_streaks * self.contrast_hu,
        )
        if fitted is None:
            return None
        unknowns = fitted.unknowns
        outer = self.voxels.beyond_mm(unknowns) > -HIDDEN_DEPTH_MM
        clear = ~in_directions(self.voxels.points_mm - unknowns[:3], hidden_ways, outer)
        return BlurredBall(
            centre_mm=unknowns[:3],
            covariance_mm2=fitted.covariance_mm2,
            radius_mm=float(unknowns[RADIUS]),
            noise_hu=fitted.noise_hu,
            metal_share=self.metal_share,
            streak_hu=fitted.streak_hu,
            contrast_hu=float(unknowns[IN] - unknowns[OUT]),
            stretch=self.voxels.stretch(unknowns, clear),
        )


def fit_rough_ball(
    region: Region,
    start_mm: Array,
    radius_mm: float,
    inside_hu: float,
    outside_hu: float,
    *,
    hidden_ways: Array | None = None,
) -> RoughBall | None:
    """Fit from a centre within about 0.3 mm; None if too few voxels are usable or nothing converges.

    `hidden_ways` (n, 3): directions from the centre in which the surface borders on something other than the
    outside; voxels near and beyond the surface there are excluded.
    """
    taking = voxels_of_ball(region, start_mm, radius_mm, hidden_ways)
    if taking.usable.sum() < MIN_VOXELS:
        return None
    covered = hidden_ways is not None and len(hidden_ways) > 0
    start = first_guess(region, start_mm, radius_mm, inside_hu, outside_hu)
    voxels = BallVoxels.of(region, taking.usable, radius_mm, covered=covered)
    settled = voxels.robust_fit(start)
    return None if settled is None else RoughBall(voxels, settled, taking.metal_share)


@dataclass(frozen=True, eq=False)
class TakingPart:
    """The voxels of a region that a fit may use, and the part of the surface too close to metal."""

    usable: NDArray[np.bool_]
    metal_share: float


def voxels_of_ball(
    region: Region, centre_mm: Array, radius_mm: float, hidden_ways: Array | None
) -> TakingPart:
    """Voxels around a ball that are clear of metal and of hidden directions (n, 3)."""
    z, y, x = region.axes_mm()
    distance = np.sqrt((z - centre_mm[0]) ** 2 + (y - centre_mm[1]) ** 2 + (x - centre_mm[2]) ** 2)
    clean = _far_from_metal(region)
    usable = (distance < radius_mm + FIT_MARGIN_MM) & clean & np.isfinite(region.values)
    if hidden_ways is not None and len(hidden_ways) > 0:
        offsets = (np.argwhere(usable) + region.start) * region.spacing_mm - centre_mm
        outer = distance[usable] > radius_mm - HIDDEN_DEPTH_MM
        usable[usable] = ~in_directions(offsets, hidden_ways, outer)
    at_surface = np.abs(distance - radius_mm) < np.max(region.spacing_mm)
    metal_share = 1.0 - float(clean[at_surface].mean()) if at_surface.any() else 0.0
    return TakingPart(usable, metal_share)


def first_guess(
    region: Region, centre_mm: Array, radius_mm: float, inside_hu: float, outside_hu: float
) -> Array:
    """The eight parameters of a ball, given only its surface."""
    slab_mm = float(np.hypot(START_BLUR_MM, region.spacing_mm[0] / np.sqrt(12.0)))
    return np.array([*centre_mm, outside_hu, inside_hu, slab_mm, START_BLUR_MM, radius_mm])


def _far_from_metal(region: Region) -> NDArray[np.bool_]:
    metal = region.values > METAL_HU  # NaN compares false
    if not metal.any():
        return np.ones(metal.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~metal, sampling=region.spacing_mm) > METAL_REACH_MM)


def in_directions(offsets_mm: Array, ways: Array, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the `asked` voxels (n, 3), relative to the centre, are in one of these directions."""
    found = np.zeros(len(asked), dtype=bool)
    if len(ways) == 0:
        return found
    looked = offsets_mm[asked]
    looked /= np.maximum(np.linalg.norm(looked, axis=1, keepdims=True), 1e-6)
    distance, _ = cKDTree(ways).query(looked, distance_upper_bound=HIDDEN_REACH)
    found[asked] = np.isfinite(distance)
    return found
