"""Registrations of many arms in the same poses: one that learns the arm, and the plain one.

All that depends on the poses alone is computed once. The adjustment is that of a case, `arm_adjustment`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.registration.arm_adjustment import PlannedAdjustment, PlannedTarget
from procedures.registration.arm_hypotheses import LARGEST_SHARE, Source, covariance_of
from procedures.registration.error_sources import TOOL_FRAME
from procedures.registration.error_theory import DEFAULT_CONFIDENCE, chi_square_limit, error_limit_mm
from procedures.registration.look_checks import LookChecks
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import (
    WIDENED_BEYOND,
    influence_of_spheres,
    predict_by_influence,
)
from procedures.registration.tracker_view import TrackerView
from procedures.steps.clinical.error_budget import GATE_ARM_RESERVE, GATE_CONFIDENCE, arm_covariance_mm2
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM

AXES = 3


@dataclass(frozen=True)
class TargetSources:
    """Sources at one target (3,) mm: those that scale with the arm's errors, and all others."""

    target_mm: Array
    arm: Sequence[Source]
    others: Sequence[Source]


@dataclass(frozen=True)
class Judged:
    """Corrections and covariances of `t` targets for `a` arms, with the residual of each arm."""

    shifts_mm: Array  # (a, t, 3)
    covariances_mm2: Array  # (a, t, 3, 3)
    chi_squares: Array  # (a,)
    gated: Array  # (a,) the same by the gate of a case
    freedom: int
    suspect: NDArray[np.bool_]  # (a,) refused for a moved sphere, or errors or corrections too large

    def refused(self, confidence: float) -> NDArray[np.bool_]:
        """Mark the arms (a,) whose residual is beyond its limit of this confidence."""
        return np.asarray(self.gated > chi_square_limit(self.freedom, confidence))

    @property
    def widening(self) -> Array:
        """Factors (a,) on the limits: 1 unless the residual is too large."""
        is_wide = self.chi_squares > chi_square_limit(self.freedom, WIDENED_BEYOND)
        return np.where(is_wide, np.sqrt(self.chi_squares / self.freedom), 1.0)

    def limits_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> Array:
        """Return the limits (a, t) of the errors, widened where the residual is too large."""
        return self.widening[:, None] * error_limit_mm(self.covariances_mm2, confidence)


@dataclass(frozen=True)
class LearnedRegistration:
    """Registration that learns the arm from its looks (m,), for `t` targets."""

    checks: LookChecks
    targets: tuple[PlannedTarget, ...]

    @classmethod
    def of(
        cls,
        points_mm: Array,
        spheres: Sequence[int],
        targets: Sequence[TargetSources],
        view: TrackerView | None = None,
    ) -> Self:
        """Prepare looks at points (m, 3) mm of these spheres (m,), which a tracker may view.

        The sources of every target are the same at the looks.
        """
        planned = PlannedAdjustment.of(points_mm, targets[0].arm, targets[0].others)
        rows = [np.flatnonzero(np.equal(spheres, one)).tolist() for one in sorted(set(spheres))]
        return cls(
            LookChecks.of(planned, rows, GATE_CONFIDENCE, view),
            tuple(PlannedTarget.of(points_mm, one.target_mm, one.arm, one.others) for one in targets),
        )

    @property
    def planned(self) -> PlannedAdjustment:
        """Adjustment of the looks."""
        return self.checks.planned

    def judge(self, residuals_mm: Array, seen_mm: Array | None = None) -> Judged:
        """Adjust `a` arms by their residuals (a, m, 3), with those (a, 3n) of the tracker's view."""
        flat = residuals_mm.reshape(len(residuals_mm), -1)
        judged = self.planned.judge(flat)
        shifts, parts = zip(*(one.correct(flat, judged.probabilities) for one in self.targets), strict=True)
        covariances = [np.sum(list(by_source.values()), axis=0) for by_source in parts]
        checked = self.checks.judge(flat, seen_mm)
        is_suspect = checked.moved.is_probable | (checked.shares > LARGEST_SHARE)
        for target, shift, covariance in zip(self.targets, shifts, covariances, strict=True):
            limits_mm = target.limit_corrections_mm(judged.probabilities, covariance)
            is_suspect |= np.linalg.norm(shift, axis=1) > limits_mm
        return Judged(
            np.stack(shifts, axis=1),
            np.stack(covariances, axis=1),
            judged.most_probable,
            judged.acceptable,
            flat.shape[1] - 6,
            is_suspect,
        )


@dataclass(frozen=True)
class PlainRegistration:
    """Unweighted registration by looks (m,), predicted for `t` targets with the sizes as stated."""

    weight: Array  # (3m, 3m) of the residuals, excluding what a pose explains
    gate_weight: Array  # (3m, 3m) the same with what the gate of a case allows for
    covariances_mm2: Array  # (t, 3, 3)

    @classmethod
    def of(cls, points_mm: Array, targets: Sequence[TargetSources], arm_mm: float = UNCALIBRATED_MM) -> Self:
        """Prepare looks at points (m, 3) mm, of an arm whose record states a sigma per axis."""
        pose = pose_jacobian(points_mm, points_mm.mean(axis=0)).reshape(-1, 6)
        arm, others = targets[0].arm, targets[0].others
        weight = _without_pose(np.asarray(np.linalg.inv(covariance_of([*arm, *others]))), pose)
        reserve = np.kron(np.eye(len(points_mm)), arm_covariance_mm2(GATE_ARM_RESERVE * arm_mm))
        tool = [
            one for one in arm if one.source == TOOL_FRAME
        ]  # common to all looks, as the gate of a case has it
        gate_weight = _without_pose(
            np.asarray(np.linalg.inv(covariance_of([*tool, *others]) + reserve)), pose
        )
        predicted = [
            predict_by_influence(influence_of_spheres(points_mm, one.target_mm), [*one.arm, *one.others])
            for one in targets
        ]
        return cls(
            weight,
            gate_weight,
            np.array([one.covariance_mm2 for one in predicted]),
        )

    def judge(self, residuals_mm: Array) -> Judged:
        """Judge the registrations of `a` arms by their residuals (a, m, 3)."""
        flat = residuals_mm.reshape(len(residuals_mm), -1)
        chi_squares, gated = (
            np.einsum("ai,ij,aj->a", flat, one, flat) for one in (self.weight, self.gate_weight)
        )
        shape = (len(flat), *self.covariances_mm2.shape)
        covariances = np.broadcast_to(self.covariances_mm2, shape)
        nothing = np.zeros(len(flat), dtype=bool)
        return Judged(np.zeros(shape[:-1]), covariances, chi_squares, gated, flat.shape[1] - 6, nothing)


def _without_pose(information: Array, pose: Array) -> Array:
    """Return the information (3m, 3m) of residuals, excluding what a pose explains."""
    on_pose = information @ pose
    return np.asarray(information - on_pose @ np.linalg.solve(pose.T @ on_pose, on_pose.T))
