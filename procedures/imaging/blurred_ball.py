"""Second estimator of a sphere's centre: a blurred ball fitted to the voxels themselves.

Unknown are the centre, both intensities, both blurs, the radius and the background. Voxels near metal are
left out and outliers (post, skin) are weighed down. The fit runs three times: with a sloping background; with
a bent one, which shows how much streaks of metal there are; and with one as bent as that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from procedures.imaging.ball_model import BALL, IN, OUT, RADIUS, SLOPE, SXY, SZ, intensities, polynomial
from procedures.imaging.noise_covariance import CorrelatedNoise
from procedures.imaging.region import Region
from procedures.imaging.robust_fit import cauchy_weights, inverse_normal, minimise, scale
from procedures.imaging.streak_background import BENT, FITTED_DEGREES, StreakPrior

Array = NDArray[np.float64]

METAL_HU = 900.0
METAL_REACH_MM = 2.2  # blur of metal is felt this far
FIT_MARGIN_MM = 2.25  # voxels up to this far outside the sphere take part
HIDDEN_DEPTH_MM = 1.5  # under a hidden surface; deeper the blur brings nothing of it
HIDDEN_REACH = 0.14  # rad, a ray stands for its surroundings; neighbours are 0.18 apart
START_BLUR_MM = 0.42  # sigma of a usual reconstruction kernel
BLUR_LIMITS_MM = (0.15, 2.0)
MIN_VOXELS = 200


@dataclass(frozen=True, eq=False)
class BlurredBall:
    """A fitted ball. Centre and covariance in grid mm (slice, row, column), intensities in HU."""

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    noise_hu: float
    blur_mm: tuple[float, float]  # sigma across slices, in the plane
    metal_share: float  # of the sphere's surface, too near metal to be used
    streak_hu: float  # usual size of the terms by which streaks bend the background, at the surface
    contrast_hu: float


def fit_blurred_ball(
    region: Region,
    start_mm: Array,
    radius_mm: float,
    inside_hu: float,
    outside_hu: float,
    *,
    hidden_ways: Array | None = None,
) -> BlurredBall | None:
    """Fit from a centre within about 0.3 mm; None when too few voxels are usable or nothing converges.

    `hidden_ways` (n, 3): directions from the centre in which the surface borders on something else than the
    outside; voxels near and beyond the surface there are left out.
    """
    z, y, x = region.axes_mm()
    distance = np.sqrt((z - start_mm[0]) ** 2 + (y - start_mm[1]) ** 2 + (x - start_mm[2]) ** 2)
    clean = _far_from_metal(region)
    usable = (distance < radius_mm + FIT_MARGIN_MM) & clean & np.isfinite(region.values)
    if hidden_ways is not None and len(hidden_ways) > 0:
        usable &= ~_hidden(region, start_mm, hidden_ways, distance > radius_mm - HIDDEN_DEPTH_MM)
    if usable.sum() < MIN_VOXELS:
        return None
    at_surface = np.abs(distance - radius_mm) < np.max(region.spacing_mm)
    metal_share = 1.0 - float(clean[at_surface].mean()) if at_surface.any() else 0.0
    slab_mm = float(np.hypot(START_BLUR_MM, region.spacing_mm[0] / np.sqrt(12.0)))
    start = np.array([*start_mm, outside_hu, inside_hu, slab_mm, START_BLUR_MM, radius_mm])
    fitted = _Voxels.of(region, usable, radius_mm).fit(start)
    if fitted is None:
        return None
    return BlurredBall(
        centre_mm=fitted.unknowns[:3],
        covariance_mm2=fitted.covariance_mm2,
        radius_mm=float(fitted.unknowns[RADIUS]),
        noise_hu=fitted.noise_hu,
        blur_mm=(float(fitted.unknowns[SZ]), float(fitted.unknowns[SXY])),
        metal_share=metal_share,
        streak_hu=fitted.streak_hu,
        contrast_hu=float(fitted.unknowns[IN] - fitted.unknowns[OUT]),
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    unknowns: Array
    covariance_mm2: Array
    noise_hu: float
    streak_hu: float


@dataclass(frozen=True, eq=False)
class _Voxels:
    """The voxels that take part: indices and grid mm (n, 3), HU (n,), terms of the background (n, m)."""

    where: NDArray[np.int64]
    points_mm: Array
    values: Array
    places: Array  # (n, 3) in radii from their middle
    background: Array
    spacing_mm: Array
    farthest_mm: float  # from the start: further away is another object

    @classmethod
    def of(cls, region: Region, usable: NDArray[np.bool_], radius_mm: float) -> _Voxels:
        where = np.argwhere(usable)
        points_mm = (where + region.start) * region.spacing_mm
        places = (points_mm - points_mm.mean(axis=0)) / radius_mm
        background = polynomial(places, FITTED_DEGREES)
        values = region.values[usable]
        return cls(where, points_mm, values, places, background, region.spacing_mm, 0.5 * radius_mm)

    def fit(self, ball: Array) -> _Fit | None:
        """Fit from the unknowns of the ball alone; None when nothing settles nearby."""
        sloping = np.zeros(SLOPE.stop)
        sloping[:BALL] = ball
        settled = self._minimum(sloping, np.zeros(SLOPE.stop), ball)
        if settled is None:
            return None
        bent = np.zeros(BALL + self.background.shape[1])
        bent[: SLOPE.stop] = settled
        free = np.zeros(len(bent))
        settled = self._minimum(bent, free, ball)
        if settled is None:
            return None
        derivatives, pull, weights, _ = self._at(settled)
        noise = CorrelatedNoise.of_residuals(self.where, pull, len(settled), self.spacing_mm)
        inverse = inverse_normal(derivatives, weights, free)
        prior = StreakPrior.of_free_fit(settled, derivatives @ inverse[:, BENT], noise)
        stiffness = prior.stiffness(len(bent))
        settled = self._minimum(settled, stiffness, ball)
        if settled is None:
            return None
        derivatives, pull, weights, noise_hu = self._at(settled)
        noise = CorrelatedNoise.of_residuals(self.where, pull, SLOPE.stop, self.spacing_mm)
        inverse = inverse_normal(derivatives, weights, stiffness)
        influence = derivatives @ inverse[:, :3]  # mm by which one HU of pull moves the centre
        covariance_mm2 = noise.covariance_mm2(influence)
        covariance_mm2 += prior.covariance_mm2(inverse, influence, weights, self.places)
        return _Fit(settled, covariance_mm2, noise_hu, prior.streak_hu)

    def _minimum(self, start: Array, stiffness: Array, ball: Array) -> Array | None:
        background = self.background[:, : len(start) - BALL]
        settled = minimise(
            lambda unknowns: intensities(self.points_mm, unknowns, background),
            self.values,
            start,
            stiffness,
            _with_possible_blur,
        )
        if settled is None or np.linalg.norm(settled[:3] - ball[:3]) > self.farthest_mm:
            return None
        return settled

    def _at(self, unknowns: Array) -> tuple[Array, Array, Array, float]:
        """Derivatives, pull w·r of the residuals, weights, and the noise in HU."""
        modelled, derivatives = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        noise_hu = scale(residuals)
        weights = cauchy_weights(residuals, noise_hu)
        return derivatives, weights * residuals, weights, noise_hu


def _with_possible_blur(unknowns: Array) -> Array:
    unknowns[[SZ, SXY]] = np.clip(unknowns[[SZ, SXY]], *BLUR_LIMITS_MM)
    return unknowns


def _far_from_metal(region: Region) -> NDArray[np.bool_]:
    metal = region.values > METAL_HU  # NaN compares false
    if not metal.any():
        return np.ones(metal.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~metal, sampling=region.spacing_mm) > METAL_REACH_MM)


def _hidden(region: Region, centre_mm: Array, ways: Array, outer: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Outer voxels that lie in one of these directions."""
    where = np.argwhere(outer)
    offsets = (where + region.start) * region.spacing_mm - centre_mm
    offsets /= np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-6)
    distance, _ = cKDTree(ways).query(offsets, distance_upper_bound=HIDDEN_REACH)
    hidden = np.zeros(outer.shape, dtype=bool)
    hidden[tuple(where[np.isfinite(distance)].T)] = True
    return hidden
