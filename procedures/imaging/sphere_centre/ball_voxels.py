"""Choose the voxels that a blurred ball is fitted to, and fit robustly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from procedures.imaging.sphere_centre.ball_model import (
    BALL,
    RADIUS,
    SLOPE,
    SXY,
    SZ,
    Stretch,
    cauchy_growth,
    cauchy_weights,
    flat_growth,
    flat_weights,
    intensities,
    minimise,
    polynomial,
    products,
    scale,
    stretched_ball,
)
from procedures.imaging.volume import Region

Array = NDArray[np.float64]

BLUR_LIMITS_MM = (0.15, 2.0)
MIN_VOXELS = 200
SHAPE_STEPS = 3
CORRELATED = 5.0  # variance relative to that of independent voxels: noise is correlated over a few
OUTLIER = 5.0  # deviations: noise alone reaches this in one sphere of a hundred
OUTLIER_REACH_MM = 1.2  # and at least a voxel: reach of another object's blur

FITTED_DEGREES = (1, 2, 3)

METAL_HU = 900.0

METAL_REACH_MM = 2.2  # reach of blur from metal

FIT_MARGIN_MM = 2.25  # voxels up to this far outside the sphere are used

HIDDEN_DEPTH_MM = 1.5  # under a hidden surface; its blur does not reach deeper

HIDDEN_REACH = 0.14  # rad; a ray represents its surroundings, neighbours are 0.18 apart

START_BLUR_MM = 0.42  # sigma of a typical reconstruction kernel


@dataclass(frozen=True, eq=False)
class BallVoxels:
    """Voxels used in a fit: indices and grid mm (n, 3), HU (n,), background terms (n, m)."""

    where: NDArray[np.int64]
    points_mm: Array
    values: Array
    places: Array  # (n, 3) in radii from their centroid
    background: Array
    spacing_mm: Array
    farthest_mm: float  # from the start; farther away is another object
    covered: bool = False  # much of the surface borders on something else, whose traces may be anywhere

    @classmethod
    def of(
        cls, region: Region, usable: NDArray[np.bool_], radius_mm: float, *, covered: bool = False
    ) -> Self:
        """Take the usable voxels of a region around a ball of about this radius."""
        where = np.argwhere(usable)
        points_mm = (where + region.start) * region.spacing_mm
        places = (points_mm - points_mm.mean(axis=0)) / radius_mm
        background = polynomial(places, FITTED_DEGREES)
        values = region.values[usable]
        return cls(where, points_mm, values, places, background, region.spacing_mm, 0.5 * radius_mm, covered)

    def robust_fit(self, ball: Array) -> Array | None:
        """Fit all parameters from those of the ball alone; None if the fit does not converge nearby.

        A linear background comes first, since it converges from farther away, then the full polynomial.
        """
        sloping = np.zeros(SLOPE.stop)
        sloping[:BALL] = ball
        settled = self._minimum(sloping, ball)
        if settled is None:
            return None
        bent = np.zeros(BALL + self.background.shape[1])
        bent[: SLOPE.stop] = settled
        return self._minimum(bent, ball)

    def _minimum(self, start: Array, ball: Array) -> Array | None:
        background = self.background[:, : len(start) - BALL]
        settled = minimise(
            lambda unknowns: intensities(self.points_mm, unknowns, background),
            self.values,
            start,
            _with_possible_blur,
        )
        if settled is None or np.linalg.norm(settled[:3] - ball[:3]) > self.farthest_mm:
            return None
        return settled

    def without_outliers(self, unknowns: Array) -> BallVoxels:
        """Drop voxels that do not belong to the fitted ball, such as its post, and their blur."""
        modelled, _ = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        strange = np.abs(residuals) > OUTLIER * scale(residuals)
        if not strange.any():
            return self
        scaled = self.points_mm / np.maximum(OUTLIER_REACH_MM, self.spacing_mm)
        distance, _ = cKDTree(scaled[strange]).query(scaled, distance_upper_bound=1.0 + 1e-6)
        clear = ~np.isfinite(distance)
        if clear.sum() < MIN_VOXELS:
            return self
        return replace(
            self,
            where=self.where[clear],
            points_mm=self.points_mm[clear],
            values=self.values[clear],
            places=self.places[clear],
            background=self.background[clear],
        )

    def beyond_mm(self, unknowns: Array) -> Array:
        """Distance (n,) of each voxel outside a ball."""
        return np.asarray(np.linalg.norm(self.points_mm - unknowns[:3], axis=1) - unknowns[RADIUS])

    def stretch(self, unknowns: Array, clear: NDArray[np.bool_]) -> Stretch:
        """Stretch of a fitted ball, from the voxels (n,) that are clear of other objects."""
        places = self.points_mm[clear]
        modelled, derivatives = intensities(places, unknowns, self.background[clear])
        derivatives = stretched_ball(places, unknowns, derivatives)
        residuals = self.values[clear] - modelled
        left, weights = residuals, np.ones(len(residuals))
        for _ in range(SHAPE_STEPS):
            normal = products(derivatives, weights[:, None] * derivatives)
            answer = np.linalg.pinv(normal, hermitian=True)
            step = answer @ (derivatives.T @ (weights * residuals))
            left = residuals - derivatives @ step
            weights = flat_weights(left, scale(left))
        return Stretch.of_last_terms(step, CORRELATED * scale(left) ** 2 * np.asarray(answer))

    def at(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Derivatives (n, m), weighted residuals w·r (n,) and weights (n,) at these parameters."""
        modelled, derivatives = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        weights = (cauchy_weights if self.covered else flat_weights)(residuals, scale(residuals))
        return derivatives, weights * residuals, weights

    def growth(self, weights: Array) -> float:
        """Mean growth of the weighted residual with the residual, relative to its weight."""
        return (cauchy_growth if self.covered else flat_growth)(weights)


def _with_possible_blur(unknowns: Array) -> Array:
    unknowns[[SZ, SXY]] = np.clip(unknowns[[SZ, SXY]], *BLUR_LIMITS_MM)
    return unknowns


def voxels_of_ball(
    region: Region, centre_mm: Array, radius_mm: float, hidden_ways: Array | None
) -> tuple[NDArray[np.bool_], float]:
    """Mark the voxels around a ball that are clear of metal and of hidden directions (n, 3).

    Also returns the part of the ball's surface that is too close to metal.
    """
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
    return usable, metal_share


def first_guess(
    region: Region, centre_mm: Array, radius_mm: float, inside_hu: float, outside_hu: float
) -> Array:
    """Guess the eight parameters of a ball from its surface."""
    slab_mm = float(np.hypot(START_BLUR_MM, region.spacing_mm[0] / np.sqrt(12.0)))
    return np.array([*centre_mm, outside_hu, inside_hu, slab_mm, START_BLUR_MM, radius_mm])


def _far_from_metal(region: Region) -> NDArray[np.bool_]:
    metal = region.values > METAL_HU  # NaN compares false
    if not metal.any():
        return np.ones(metal.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~metal, sampling=region.spacing_mm) > METAL_REACH_MM)


def in_directions(offsets_mm: Array, ways: Array, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the `asked` voxels (n, 3), relative to the centre, that lie in one of these directions."""
    found = np.zeros(len(asked), dtype=bool)
    if len(ways) == 0:
        return found
    looked = offsets_mm[asked]
    looked /= np.maximum(np.linalg.norm(looked, axis=1, keepdims=True), 1e-6)
    distance, _ = cKDTree(ways).query(looked, distance_upper_bound=HIDDEN_REACH)
    found[asked] = np.isfinite(distance)
    return found
