"""The voxels that a blurred ball is fitted to, and the robust fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from procedures.imaging.region import Region
from procedures.imaging.sphere_centre.ball_model import (
    BALL,
    RADIUS,
    SLOPE,
    SXY,
    SZ,
    intensities,
    polynomial,
)
from procedures.imaging.sphere_centre.robust_fit import (
    cauchy_growth,
    cauchy_weights,
    flat_growth,
    flat_weights,
    minimise,
    products,
    scale,
)
from procedures.imaging.sphere_centre.streak_background import FITTED_DEGREES
from procedures.imaging.sphere_centre.stretch import Stretch, stretched_ball

Array = NDArray[np.float64]

BLUR_LIMITS_MM = (0.15, 2.0)
MIN_VOXELS = 200
SHAPE_STEPS = 3
CORRELATED = 5.0  # variance relative to that of independent voxels: noise is correlated over a few
OUTLIER = 5.0  # deviations: noise alone reaches this in one sphere of a hundred
OUTLIER_REACH_MM = 1.2  # and at least a voxel: reach of another object's blur


@dataclass(frozen=True, eq=False)
class BallVoxels:
    """The voxels used: indices and grid mm (n, 3), HU (n,), background terms (n, m)."""

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
        """The usable voxels of a region around a ball of about this radius."""
        where = np.argwhere(usable)
        points_mm = (where + region.start) * region.spacing_mm
        places = (points_mm - points_mm.mean(axis=0)) / radius_mm
        background = polynomial(places, FITTED_DEGREES)
        values = region.values[usable]
        return cls(where, points_mm, values, places, background, region.spacing_mm, 0.5 * radius_mm, covered)

    def robust_fit(self, ball: Array) -> Array | None:
        """All parameters, given those of the ball alone; None if the fit does not converge nearby.

        First with a linear background, which converges from farther away, then with the full polynomial.
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
        """Without voxels that do not belong to the fitted ball, such as its post, and their blur."""
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
        """Distance of each voxel (n,) outside a ball."""
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

    def at(self, unknowns: Array) -> tuple[Array, Array, Array, float]:
        """Derivatives (n, m), weighted residuals w·r (n,), weights (n,), and the noise in HU."""
        modelled, derivatives = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        noise_hu = scale(residuals)
        weights = (cauchy_weights if self.covered else flat_weights)(residuals, noise_hu)
        return derivatives, weights * residuals, weights, noise_hu

    def growth(self, weights: Array) -> float:
        """Mean growth of the weighted residual with the residual, relative to its weight."""
        return (cauchy_growth if self.covered else flat_growth)(weights)


def _with_possible_blur(unknowns: Array) -> Array:
    unknowns[[SZ, SXY]] = np.clip(unknowns[[SZ, SXY]], *BLUR_LIMITS_MM)
    return unknowns
