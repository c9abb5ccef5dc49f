"""Adjustment of many arms in the same poses, as `ArmLearning` adjusts one, and their plain registration.

All that depends on the poses alone is computed once: under each hypothesis, the weights of the residuals, the
influence of the looks on every target and the covariance there. The formulas are those of `arm_learning`,
implemented a second time for arrays: a test compares the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import logsumexp

from procedures.registration.arm_learning import ACCEPTABLE, HYPOTHESES, PRIOR, Source, covariance_of
from procedures.registration.error_theory import DEFAULT_CONFIDENCE, chi_square_limit, error_limit_mm
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import (
    WIDENED_BEYOND,
    SharedErrors,
    influence_of_spheres,
    predict_by_influence,
)
from procedures.steps.clinical.error_budget import GATE_ARM_RESERVE, arm_covariance_mm2
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM

AXES = 3
TOOL_FRAME = "tool frame"  # the source whose share the gate of a case takes as common to all looks


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

    def refused(self, confidence: float) -> Array:
        """Mark the arms (a,) whose residual is beyond its limit of this confidence."""
        return np.asarray(self.gated > chi_square_limit(self.freedom, confidence))

    def limits_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> Array:
        """Return the limits (a, t) of the errors, widened where the residual is too large."""
        is_wide = self.chi_squares > chi_square_limit(self.freedom, WIDENED_BEYOND)
        widening = np.where(is_wide, np.sqrt(self.chi_squares / self.freedom), 1.0)
        return widening[:, None] * error_limit_mm(self.covariances_mm2, confidence)


@dataclass(frozen=True)
class PlannedAdjustment:
    """Looks (m,) prepared under all hypotheses, with the influence on `t` targets."""

    log_odds: Array  # (h,) of each hypothesis, for residuals of zero
    weights: Array  # (h, 3m, 3m) of the residuals, excluding what a pose explains
    influences: Array  # (t, h, 3, 3m)
    covariances_mm2: Array  # (t, h, 3, 3)

    @classmethod
    def of(cls, points_mm: Array, targets: Sequence[TargetSources]) -> Self:
        """Prepare looks at points (m, 3) mm; the sources of every target are the same at the looks."""
        centre, scatter = points_mm.mean(axis=0), np.eye(AXES * len(points_mm))
        pose = pose_jacobian(points_mm, centre).reshape(-1, 6)
        arm_mm2, others_mm2 = (covariance_of(one) for one in (targets[0].arm, targets[0].others))
        together = [_covariance_with(one.arm) for one in targets]
        at_target = [pose_jacobian(one.target_mm, centre) for one in targets]
        apart = [(_covariance_at(one.arm), _covariance_at(one.others)) for one in targets]
        log_odds, weights, influences, covariances = [], [], [], []
        for one, prior in zip(HYPOTHESES, PRIOR, strict=True):
            covariance = one.share**2 * arm_mm2 + others_mm2 + one.scatter_mm**2 * scatter
            information = np.linalg.inv(covariance)
            on_pose = information @ pose
            normal = pose.T @ on_pose
            weights.append(information - on_pose @ np.linalg.solve(normal, on_pose.T))
            log_odds.append(prior - 0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1]))
            for target, jacobian, (own_arm, own_others) in zip(together, at_target, apart, strict=True):
                common = one.share**2 * target.T
                explained = common @ information
                missing = np.linalg.solve(normal, (jacobian - explained @ pose).T).T
                influence = explained + missing @ on_pose.T
                crossed = influence @ common.T
                own = one.share**2 * own_arm + own_others + one.scatter_mm**2 * np.eye(AXES)
                influences.append(influence)
                covariances.append(own - crossed - crossed.T + influence @ covariance @ influence.T)
        shape = (len(HYPOTHESES), len(targets), AXES, -1)
        return cls(
            np.array(log_odds),
            np.array(weights),
            np.array(influences).reshape(shape).swapaxes(0, 1),
            np.array(covariances).reshape(shape).swapaxes(0, 1),
        )

    def judge(self, residuals_mm: Array) -> Judged:
        """Adjust `a` arms by their residuals (a, m, 3)."""
        flat = residuals_mm.reshape(len(residuals_mm), -1)
        chi_squares = np.einsum("ai,hij,aj->ah", flat, self.weights, flat, optimize=True)
        log_odds = self.log_odds - 0.5 * chi_squares
        odds = np.exp(log_odds - logsumexp(log_odds, axis=1, keepdims=True))
        shifts = np.einsum("thij,aj->ahti", self.influences, flat)
        mean = np.einsum("ah,ahti->ati", odds, shifts)
        apart = shifts - mean[:, None]
        covariances = np.einsum("ah,thij->atij", odds, self.covariances_mm2)
        covariances = covariances + np.einsum("ah,ahti,ahtj->atij", odds, apart, apart)
        arms = np.arange(len(flat))
        best, accepted = odds.argmax(axis=1), np.where(ACCEPTABLE, odds, -1.0).argmax(axis=1)
        return Judged(
            mean, covariances, chi_squares[arms, best], chi_squares[arms, accepted], flat.shape[1] - 6
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
        tool = [one for one in arm if one.source == TOOL_FRAME]
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
        return Judged(np.zeros(shape[:-1]), covariances, chi_squares, gated, flat.shape[1] - 6)


def _without_pose(information: Array, pose: Array) -> Array:
    """Return the information (3m, 3m) of residuals, excluding what a pose explains."""
    on_pose = information @ pose
    return np.asarray(information - on_pose @ np.linalg.solve(pose.T @ on_pose, on_pose.T))


def _covariance_with(sources: Sequence[Source]) -> Array:
    """Return the covariance (3m, 3) mm2 of all looks with the target."""
    found: Array = np.zeros((1, 1))
    for one in sources:
        if isinstance(one, SharedErrors):
            columns = one.at_spheres_mm.reshape(-1, one.at_spheres_mm.shape[-1])
            found = found + columns @ one.at_target_mm.T
    return found


def _covariance_at(sources: Sequence[Source]) -> Array:
    """Return the covariance (3, 3) mm2 of the tool at the target."""
    found: Array = np.zeros((AXES, AXES))
    for one in sources:
        if isinstance(one, SharedErrors):
            found = found + one.at_target_mm @ one.at_target_mm.T
        else:
            found = found + one.at_target_mm2
    return found
