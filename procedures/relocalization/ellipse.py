"""Robust ellipse fit to rim points.

The ellipse is |S (x - c)| = 1 with S symmetric and positive definite. Residuals are first-order geometric
distances (Sampson). The first iterations use the points that best agree on a circle, since a sphere's outline
is nearly one and a wrong arc would distort an ellipse; the later ones weight all points by Tukey's biweight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import robust_sigma

START_ITERATIONS = 3
CIRCLES = 80  # each through three points: with half of the rim wrong, ten of them are right
AGREEMENT_PX = 0.6  # the outline of a sphere in a corner of the image deviates this much from a circle
SEED = 20250711
ITERATIONS = 12
TUKEY = 4.685  # 95 % efficiency for normal errors
SIGMA_FLOOR_PX = 0.01  # smaller residuals come from the model, not from noise
STEP_END_PX = 1e-4
LEAST_POINTS = 10


@dataclass(frozen=True)
class Ellipse:
    """Ellipse |S (x - c)| = 1 with centre c = `centre_px` (x, y) and S from `shape`, in 1/px."""

    centre_px: tuple[float, float]
    shape: tuple[float, float, float]  # S_xx, S_xy, S_yy

    @cached_property
    def axes_px(self) -> tuple[float, float]:
        """Semi-axes, major first."""
        low, high = np.linalg.eigvalsh(self.matrix)
        return float(1.0 / low), float(1.0 / high)

    @property
    def matrix(self) -> Array:
        xx, xy, yy = self.shape
        return np.array([[xx, xy], [xy, yy]])

    def radius_at(self, angle_rad: Array) -> Array:
        """Return the centre-to-rim distance in px in the directions `angle_rad`."""
        direction = np.stack([np.cos(angle_rad), np.sin(angle_rad)])
        return np.asarray(1.0 / np.linalg.norm(self.matrix @ direction, axis=0))

    def distance_px(self, points_px: Array) -> Array:
        """Return the signed first-order distance of points (n, 2) from the rim in px, positive outside."""
        return _residuals(np.array([*self.centre_px, *self.shape]), points_px)[0]


@dataclass(frozen=True)
class EllipseFit:
    """Fitted ellipse, its points (n, 2), their weights and residuals (n,), scatter, covariance of the centre.

    `centre_gain` is the shift of the centre by a shift of each point, outwards.
    """

    ellipse: Ellipse
    points_px: Array
    weights: Array
    residual_px: Array
    sigma_px: float
    centre_gain: Array  # (2, n)
    centre_covariance_px2: Array  # (2, 2)


def circle_as_ellipse(centre_px: tuple[float, float], radius_px: float) -> Ellipse:
    """Convert a circle to an ellipse."""
    return Ellipse(centre_px, (1.0 / radius_px, 0.0, 1.0 / radius_px))


def fit_ellipse(points_px: Array, start: Ellipse, *, rough_start: bool = True) -> EllipseFit | None:
    """Fit an ellipse to points (n, 2) from a start within a few pixels, or return None if undefined.

    With `rough_start` false, the start is on the rim to within its noise and the consensus search is skipped.
    """
    if len(points_px) < LEAST_POINTS:
        return None
    parameters = np.array([*start.centre_px, *start.shape])
    mean_radius = float(np.sqrt(np.prod(start.axes_px)))
    scale = 1.0 / np.array([1.0, 1.0, *(3 * [mean_radius**2])])  # one unit moves the rim by 1 px
    agreeing = _mark_agreeing(points_px).astype(float) if rough_start else np.ones(len(points_px))
    for iteration in range(START_ITERATIONS + ITERATIONS):
        residual, jacobian = _residuals(parameters, points_px)
        is_starting = rough_start and iteration < START_ITERATIONS
        weights = agreeing if is_starting else _tukey_weights(residual)[0]
        design = jacobian * scale
        normal = (design * weights[:, None]).T @ design
        try:
            step = np.linalg.solve(normal, -design.T @ (weights * residual))
        except np.linalg.LinAlgError:
            return None
        parameters = parameters + scale * step
        if not np.all(np.isfinite(parameters)) or parameters[2] * parameters[4] <= parameters[3] ** 2:
            return None
        if not is_starting and np.abs(step).max() < STEP_END_PX:
            break
    residual, jacobian = _residuals(parameters, points_px)
    weights, sigma = _tukey_weights(residual)
    design = jacobian * scale
    normal = (design * weights[:, None]).T @ design
    if np.linalg.cond(normal) > 1e12:
        return None
    x, y, xx, xy, yy = (float(value) for value in parameters)
    inverse = np.linalg.inv(normal)[:2]
    gain: Array = np.asarray(-inverse @ (design * weights[:, None]).T, dtype=float)
    covariance: Array = np.asarray(sigma**2 * inverse[:, :2], dtype=float)
    return EllipseFit(Ellipse((x, y), (xx, xy, yy)), points_px, weights, residual, sigma, gain, covariance)


def _residuals(parameters: Array, points_px: Array) -> tuple[Array, Array]:
    """Return distances (n,) and their derivatives (n, 5) with respect to centre and shape."""
    x = points_px[:, 0] - parameters[0]
    y = points_px[:, 1] - parameters[1]
    xx, xy, yy = parameters[2:]
    u, v = xx * x + xy * y, xy * x + yy * y  # S (x - c)
    length = np.maximum(np.hypot(u, v), 1e-9)
    slope_x = (xx * u + xy * v) / length  # derivative of |S (x - c)| with respect to the point
    slope_y = (xy * u + yy * v) / length
    steepness = np.maximum(np.hypot(slope_x, slope_y), 1e-12)
    jacobian = np.empty((len(points_px), 5))
    columns = (-slope_x, -slope_y, x * u / length, (x * v + y * u) / length, y * v / length)
    for number, column in enumerate(columns):
        jacobian[:, number] = column
    return (length - 1.0) / steepness, jacobian / steepness[:, None]


def _mark_agreeing(points_px: Array) -> Mask:
    """Flag the points near the three-point circle with the largest consensus."""
    triples = np.random.default_rng(SEED).integers(0, len(points_px), (CIRCLES, 3))
    a, b, c = (points_px[triples[:, corner]] for corner in range(3))
    offset = circumcentre_offsets(b - a, c - a, least_area=1e-6)
    centre = a + offset
    distance = np.hypot(points_px[:, 0] - centre[:, :1], points_px[:, 1] - centre[:, 1:])
    near = np.abs(distance - np.hypot(offset[:, 0], offset[:, 1])[:, None]) < AGREEMENT_PX
    return np.asarray(near[near.sum(axis=1).argmax()])


def circumcentre_offsets(ab: Array, ac: Array, least_area: float) -> Array:
    """Return circumcentres (n, 2) of points a, b, c relative to a, or 0 where they are nearly collinear."""
    doubled_area = 2.0 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    doubled_area = np.where(np.abs(doubled_area) < least_area, np.inf, doubled_area)
    square_ab, square_ac = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    offset = np.stack(
        [ac[:, 1] * square_ab - ab[:, 1] * square_ac, ab[:, 0] * square_ac - ac[:, 0] * square_ab], axis=1
    )
    return np.asarray(offset / doubled_area[:, None])


def _tukey_weights(residual: Array) -> tuple[Array, float]:
    sigma = max(robust_sigma(residual), SIGMA_FLOOR_PX)
    ratio = np.minimum(np.abs(residual) / (TUKEY * sigma), 1.0)
    return np.asarray((1.0 - ratio**2) ** 2), sigma
