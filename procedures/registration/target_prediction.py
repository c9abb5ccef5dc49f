"""Prediction of the target error from errors shared by all poses and from independent errors.

An error of the arm (a link too long, a wrong tool frame) displaces the tool at every sphere and again at the
target. The first corrupts what the registration recorded, the second what the arm then reaches; through the
registration the two subtract:

    error at the target = (J_t - sum_i W_i J_i) s  +  e_t  -  sum_i W_i e_i

s: sizes of the shared errors; J: displacement of the tool per shared error at target (t) and sphere (i); e:
independent errors; W: effect of a recorded sphere on the target through the fit. To first order in all
errors, like the covariances of Danilchenko and Fitzpatrick 2011. Independent of any arm:
`procedures.calibration.arm_sources` computes one's displacements.

Shared errors do not average out: if the tool's orientation differs between points, an error of the tool frame
displaces all of them together. Residuals are therefore judged with the full covariance of all coordinates.
What the pose explains leaves no residual. If the residual is larger than all sources together state, some
source is larger or missing: the limit is then widened by the ratio (Birge 1932, The calculation of errors by
the method of least squares), never narrowed. How far one displaced point puts a target off before the gate
notices is its external reliability (Baarda 1968, A testing procedure for use in geodetic networks).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from procedures.registration.error_theory import (
    DEFAULT_CONFIDENCE,
    FreGate,
    chi_square_limit,
    degrees_of_freedom,
    propagate,
    rare_limit_mm,
)
from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array, Mask

AXES = 3

# Of the residual, beyond which the limit is widened: one registration in twenty with right sources is, too.
WIDENED_BEYOND = 0.95

# Of all cases, in which something was displaced that no look has shown. (U) Counted as certain, it made the
# 95 % limit hold 99 % of replayed targets.
# Safety against a target that is further off than the stated limit.
RARE_SHARE = 0.4

DIRECTIONS = 2000  # 3 degrees apart: the worst is missed by 0.1 % at most
GOLDEN_ANGLE_RAD = np.pi * (3.0 - 5.0**0.5)


@dataclass(frozen=True)
class SharedErrors:
    """Errors from one source that act at all poses: `k` independent errors of one standard deviation each.

    Displacement of the true tool from its assumed position, mm in the frame of the targets.
    """

    source: str
    at_spheres_mm: Array  # (n, 3, k)
    at_target_mm: Array  # (3, k)


@dataclass(frozen=True)
class IndependentErrors:
    """Errors from one source that are independent between poses, as covariances in mm2.

    A `rare` one is there in `RARE_SHARE` of all cases.
    """

    source: str
    at_spheres_mm2: Array  # (n, 3, 3) of a recorded sphere
    at_target_mm2: Array  # (3, 3) of the tool at the target
    rare: bool = False


@dataclass(frozen=True)
class AllowedErrors:
    """Errors at `n` spheres that a residual gate allows for: independent ones (mm2) and shared ones (mm).

    `freedom` is the number of degrees of freedom from which the size of both was estimated, None if stated.
    """

    independent_mm2: Array  # (n, 3, 3)
    shared_mm: Array  # (n, 3, k) displacement by one standard deviation of each error
    freedom: float | None = None

    def __getitem__(self, rows: Mask | Sequence[int]) -> AllowedErrors:
        """Select spheres."""
        return AllowedErrors(self.independent_mm2[rows], self.shared_mm[rows], self.freedom)


@dataclass(frozen=True)
class ResidualCheck:
    """Residual of a fit, as chi-square by all that the sources state, and its degrees of freedom."""

    chi_square: float
    freedom: int

    @property
    def widening(self) -> float:
        """Factor on the stated size of the errors: 1 unless the residual is too large for it."""
        if self.chi_square <= chi_square_limit(self.freedom, WIDENED_BEYOND):
            return 1.0
        return float(np.sqrt(self.chi_square / self.freedom))


@dataclass(frozen=True)
class TargetPrediction:
    """Covariance (3, 3) mm2 of the error at one target due to each source; sources are independent.

    `widening` is the factor on the sources that act at the spheres, `at_spheres`: the residual tests no
    others. It counts in the limit alone; the rest is as stated. The `rare` sources count whole in the rms,
    and in the limit as often as they are there.
    """

    by_source_mm2: dict[str, Array]
    at_spheres: frozenset[str] = frozenset()
    widening: float = 1.0
    rare: frozenset[str] = frozenset()

    @property
    def covariance_mm2(self) -> Array:
        """Covariance of the total error."""
        return np.asarray(np.sum(list(self.by_source_mm2.values()), axis=0))

    @property
    def rms_mm(self) -> float:
        """Rms magnitude of the error."""
        return float(np.sqrt(np.trace(self.covariance_mm2)))

    @property
    def budget_mm(self) -> dict[str, float]:
        """Rms contribution of each source; their squares add up to the square of the total."""
        return {name: float(np.sqrt(np.trace(part))) for name, part in self.by_source_mm2.items()}

    def limit_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> float:
        """Return the radius in mm that contains the error with this probability. Raises REG-007."""
        tested = sum(part for name, part in self.by_source_mm2.items() if name in self.at_spheres)
        covariance = self.covariance_mm2 + (self.widening**2 - 1.0) * tested
        found = (part for name, part in self.by_source_mm2.items() if name in self.rare)  # a set has no order
        rare = sum(found, np.zeros((AXES, AXES)))
        return rare_limit_mm(covariance - rare, rare, RARE_SHARE, confidence)

    def mark_contained(self, errors_mm: ArrayLike, confidence: float = DEFAULT_CONFIDENCE) -> Mask:
        """Mark the errors (..., 3) inside the ellipsoid of this probability."""
        errors = np.asarray(errors_mm, dtype=float)
        weighted = np.linalg.solve(self.covariance_mm2, errors.reshape(-1, AXES).T).T.reshape(errors.shape)
        return np.asarray((errors * weighted).sum(axis=-1) <= chi_square_limit(AXES, confidence))


def predict_target_error(
    spheres_mm: ArrayLike,
    target_mm: ArrayLike,
    sources: Sequence[SharedErrors | IndependentErrors],
    weights: ArrayLike | None = None,
    residual: ResidualCheck | None = None,
) -> TargetPrediction:
    """Predict the error at a target (3,) mm registered by spheres (n, 3) mm, all in one frame.

    `weights` (n, 3, 3) are those of the fit, the inverse covariances of the pairs; None for an unweighted
    fit. A `residual` too large for the sources widens the limit.
    """
    spheres, target = np.asarray(spheres_mm, dtype=float), np.asarray(target_mm, dtype=float)
    return predict_by_influence(influence_of_spheres(spheres, target, weights), sources, residual)


def predict_by_influence(
    influence: Array,
    sources: Sequence[SharedErrors | IndependentErrors],
    residual: ResidualCheck | None = None,
) -> TargetPrediction:
    """Predict the error at a target by the influence (n, 3, 3) of each sphere on it.

    A `residual` too large for the sources widens the limit.
    """
    parts: dict[str, Array] = {}
    tested: set[str] = set()  # by the residual, as they displace a sphere
    rare = frozenset(one.source for one in sources if isinstance(one, IndependentErrors) and one.rare)
    for one in sources:
        if isinstance(one, SharedErrors):
            at_spheres = one.at_spheres_mm
            shift = one.at_target_mm - np.einsum("nij,njk->ik", influence, at_spheres)
            part = shift @ shift.T
        else:
            at_spheres = one.at_spheres_mm2
            part = one.at_target_mm2 + propagate(influence, at_spheres).sum(axis=0)
        parts[one.source] = parts.get(one.source, np.zeros((AXES, AXES))) + part
        if at_spheres.any():
            tested.add(one.source)
    return TargetPrediction(parts, frozenset(tested), 1.0 if residual is None else residual.widening, rare)


def check_residuals(
    residuals_mm: Array, fiducials_mm: Array, sources: Sequence[SharedErrors | IndependentErrors]
) -> ResidualCheck:
    """Test a fit's residuals (n, 3) mm at the mapped points (n, 3) mm against all sources of a prediction."""
    allowed = allow_for(sources, len(fiducials_mm))
    return ResidualCheck(
        chi_square_of_shared(residuals_mm, fiducials_mm, allowed.independent_mm2, allowed.shared_mm),
        degrees_of_freedom(len(fiducials_mm)),
    )


def allow_for(
    sources: Sequence[SharedErrors | IndependentErrors], spheres: int, freedom: float | None = None
) -> AllowedErrors:
    """Collect the errors at the spheres from all sources of a prediction."""
    independent = np.zeros((spheres, AXES, AXES))
    shared = [np.zeros((spheres, AXES, 0))]
    for one in sources:
        if isinstance(one, SharedErrors):
            shared.append(one.at_spheres_mm)
        else:
            independent = independent + one.at_spheres_mm2
    return AllowedErrors(independent, np.concatenate(shared, axis=2), freedom)


def gate_residuals(
    residuals_mm: Array, fiducials_mm: Array, allowed: AllowedErrors, confidence: float
) -> FreGate:
    """Gate a rigid fit's residuals (n, 3) mm, of any weights, at the mapped points (n, 3) mm.

    One fit in 1 / (1 - confidence) with right allowances is refused. Raises REG-002, REG-007.
    """
    chi_square = chi_square_of_shared(residuals_mm, fiducials_mm, allowed.independent_mm2, allowed.shared_mm)
    limit = chi_square_limit(degrees_of_freedom(len(fiducials_mm)), confidence, allowed.freedom)
    return FreGate(float(np.sqrt(np.mean(np.sum(residuals_mm**2, axis=1)))), chi_square, limit, confidence)


def influence_of_spheres(spheres_mm: Array, target_mm: Array, weights: ArrayLike | None = None) -> Array:
    """Return the mapped target's shift per shift of each sphere, (n, 3, 3); these sum to the identity."""
    centre = spheres_mm.mean(axis=0)
    jacobian = pose_jacobian(spheres_mm, centre)
    projected = np.swapaxes(jacobian, -1, -2)
    if weights is not None:
        projected = projected @ np.asarray(weights, dtype=float)
    pose = np.linalg.solve((projected @ jacobian).sum(axis=0), projected)
    return np.asarray(pose_jacobian(target_mm, centre) @ pose)


def chi_square_of_shared(
    residuals_mm: Array, fiducials_mm: Array, covariance_mm2: Array, shared_mm: Array
) -> float:
    """Return chi-square of a rigid fit's residuals (n, 3) mm with any weights, 3n - 6 degrees of freedom.

    `fiducials_mm` (n, 3) are the mapped points, `covariance_mm2` (n, 3, 3) is the independent part,
    `shared_mm` (n, 3, k) the displacement of every point by each of k unit errors. What a rigid motion can
    explain does not count.
    """
    residuals = residuals_mm.reshape(-1)
    return float(residuals @ _information(fiducials_mm, covariance_mm2, shared_mm) @ residuals)


@dataclass(frozen=True)
class UnnoticedPoint:
    """Point whose undetected displacement would shift a target most."""

    index: int
    displaced_mm: float
    at_target_mm: float


def find_unnoticed_point(
    fiducials_mm: Array,
    target_mm: Array,
    allowed: AllowedErrors,
    weights: ArrayLike | None,
    gate: FreGate,
    largest_mm: float,
) -> UnnoticedPoint:
    """Find the worst displacement of one point, up to `largest_mm`, that passes the gate half of the time.

    `fiducials_mm` (n, 3) are the mapped points, `weights` (n, 3, 3) are those of the fit. The expected
    chi-square is then the limit: freedom plus what the displacement alone adds. Every direction is tried.
    """
    count = len(fiducials_mm)
    full = _information(fiducials_mm, allowed.independent_mm2, allowed.shared_mm)
    information = full.reshape(count, 3, count, 3)
    spare = gate.chi_square_limit - degrees_of_freedom(count)
    influences = influence_of_spheres(fiducials_mm, target_mm, weights)
    return find_worst_displacement(
        information[np.arange(count), :, np.arange(count)], influences, spare, largest_mm
    )


def find_worst_displacement(
    information: Array, influences: Array, spare: float, largest_mm: float
) -> UnnoticedPoint:
    """Find the worst displacement of one of n points that adds no more than `spare` to chi-square.

    `information` (n, 3, 3) is how much a displacement of each point adds, `influences` (n, 3, 3) its effect
    on the target.
    """
    directions = spread_directions(DIRECTIONS)
    worst = UnnoticedPoint(0, 0.0, 0.0)
    for index, (adds, influence) in enumerate(zip(information, influences, strict=True)):
        sensitivity = np.einsum("ki,ij,kj->k", directions, adds, directions)
        displaced = np.minimum(largest_mm, np.sqrt(spare / np.maximum(sensitivity, spare / largest_mm**2)))
        shift = displaced * np.linalg.norm(directions @ influence.T, axis=1)
        if shift.max() > worst.at_target_mm:
            worst = UnnoticedPoint(index, float(displaced[shift.argmax()]), float(shift.max()))
    return worst


def _information(fiducials_mm: Array, covariance_mm2: Array, shared_mm: Array) -> Array:
    """Return the inverse covariance (3n, 3n) of residuals, excluding what rigid motions can explain."""
    columns = shared_mm.reshape(-1, shared_mm.shape[-1])
    weight = np.linalg.inv(block_diag(*covariance_mm2) + columns @ columns.T)
    pose = pose_jacobian(fiducials_mm, fiducials_mm.mean(axis=0)).reshape(-1, 6)
    weighted = weight @ pose
    return np.asarray(weight - weighted @ np.linalg.solve(pose.T @ weighted, weighted.T))


def spread_directions(count: int) -> Array:
    """Return directions (count, 3), spread uniformly over a hemisphere by the golden angle."""
    number = np.arange(count)
    height = (number + 0.5) / count
    turn = number * GOLDEN_ANGLE_RAD
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
