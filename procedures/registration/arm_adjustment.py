"""Adjustment of looks together with the arm's errors, as far as it does not depend on what they show.

With `y` the residuals of all looks from any nearby pose of the head, `d` a small change of that pose and `u`
the errors of arm and spheres,

    y = A d - S u - e,        error at a target = (S_t - W S) u + e_t - W e    for a correction by W y

in the notation of `target_prediction`. W is the best linear unbiased one: W A = A_t, and least variance at
this very target. It is universal kriging with the arm's own error columns as covariance function (Matheron
1969; Rasmussen and Williams, Gaussian processes for machine learning, 2006, section 2.7).

Under each hypothesis about the arm W depends on the poses alone. Residuals then give each hypothesis its
likelihood (restricted: the pose is integrated out). Correction and covariance are means over all hypotheses,
and the covariance includes that their corrections differ. The residuals of one case, or of many arms in the
same poses, are judged at once: `a` is their number, `h` that of the hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from procedures.registration.arm_hypotheses import (
    ACCEPTABLE,
    HYPOTHESES,
    PRIOR,
    Source,
    covariance_at_target,
    covariance_of,
    covariance_with_target,
)
from procedures.registration.error_sources import SIZES
from procedures.registration.error_theory import error_limit_mm
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import AXES, TargetPrediction, predict_by_influence
from ronna_hw.arrays import Array

# Safety against a wrong correction: none is longer than the arm's errors explain (U).
CORRECTION_CONFIDENCE = 0.999


@dataclass(frozen=True, eq=False)
class JudgedHypotheses:
    """Probability of each hypothesis by the residuals of `a` arms, and their chi-square under it."""

    probabilities: Array  # (a, h)
    chi_squares: Array  # (a, h)

    @property
    def most_probable(self) -> Array:
        """Chi-square (a,) under the most probable hypothesis."""
        return self._under(self.probabilities)

    @property
    def acceptable(self) -> Array:
        """Chi-square (a,) under the most probable hypothesis that an arm is accepted with."""
        return self._under(np.where(ACCEPTABLE, self.probabilities, -1.0))

    def _under(self, preference: Array) -> Array:
        return np.asarray(self.chi_squares[np.arange(len(preference)), preference.argmax(axis=1)])


@dataclass(frozen=True, eq=False)
class PlannedAdjustment:
    """Looks (m,) prepared under each hypothesis."""

    points_mm: Array  # (m, 3)
    informations: Array  # (h, 3m, 3m) of the looks
    weights: Array  # (h, 3m, 3m) the same of the residuals, excluding what a pose explains
    spreads: Array  # (h,) log determinants: minus twice the log likelihood of residuals of zero

    @classmethod
    def of(cls, points_mm: Array, arm: Sequence[Source], others: Sequence[Source]) -> Self:
        """Prepare looks at points (m, 3) mm of at least three different spheres."""
        pose = _pose_columns(points_mm)
        informations, weights, spreads = [], [], []
        for one in HYPOTHESES:
            covariance = covariance_of(one.sources(arm, others))
            information = np.linalg.inv(covariance)
            on_pose = pose.T @ information
            normal = on_pose @ pose
            informations.append(information)
            weights.append(information - information @ pose @ np.linalg.solve(normal, on_pose))
            spreads.append(np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1])
        return cls(points_mm, np.array(informations), np.array(weights), np.array(spreads))

    def judge(self, residuals_mm: Array) -> JudgedHypotheses:
        """Judge the hypotheses by the residuals (a, 3m) of each arm."""
        rows = residuals_mm[:, None, None]
        chi_squares = (rows @ self.weights @ residuals_mm[:, None, :, None])[..., 0, 0]
        odds = -0.5 * (self.spreads + chi_squares) + PRIOR
        return JudgedHypotheses(_normalize(odds), chi_squares)


@dataclass(frozen=True, eq=False)
class PlannedTarget:
    """Influence of looks (m,) on a target under each hypothesis, and the error that is predicted with it."""

    influences: Array  # (h, 3, 3m)
    predictions: tuple[TargetPrediction, ...]  # (h,)
    arm_mm2: Array  # (3, 3) of the arm's errors there by their stated sizes

    @classmethod
    def of(cls, points_mm: Array, target_mm: Array, arm: Sequence[Source], others: Sequence[Source]) -> Self:
        """Prepare looks at points (m, 3) mm for a target (3,) mm, by the sources there."""
        influences, predictions = [], []
        for one in HYPOTHESES:
            sources = one.sources(arm, others)
            influence = best_influence(points_mm, target_mm, sources)
            influences.append(influence.transpose(1, 0, 2).reshape(AXES, -1))
            predictions.append(predict_by_influence(influence, sources))
        return cls(np.array(influences), tuple(predictions), covariance_at_target(arm))

    def predict(self, by_source_mm2: dict[str, Array], widening: float = 1.0) -> TargetPrediction:
        """Return the prediction with these covariances (3, 3), the means over all hypotheses."""
        tested = frozenset[str]().union(*(one.at_spheres for one in self.predictions)) | {SIZES}
        return replace(self.predictions[0], by_source_mm2=by_source_mm2, at_spheres=tested, widening=widening)

    def correct(self, residuals_mm: Array, probabilities: Array) -> tuple[Array, dict[str, Array]]:
        """Return the correction (a, 3) mm and its covariance (a, 3, 3) by source, as means over hypotheses.

        Residuals are (a, 3m) mm, probabilities (a, h).
        """
        shifts = (self.influences @ residuals_mm[:, None, :, None])[..., 0]
        mean = (probabilities[:, None] @ shifts)[:, 0]
        apart = shifts - mean[:, None]
        parts = {
            name: np.sum(
                [
                    odds[:, None, None] * one.by_source_mm2[name]
                    for odds, one in zip(probabilities.T, self.predictions, strict=True)
                ],
                axis=0,
            )
            for name in self.predictions[0].by_source_mm2
        }
        parts[SIZES] = np.einsum("ah,ahi,ahj->aij", probabilities, apart, apart)
        return mean, parts

    def limit_corrections_mm(self, probabilities: Array, covariances_mm2: Array) -> Array:
        """Return the length (a,) that a correction by right looks exceeds in one case of a thousand at most.

        It is that of the arm's errors at the target, as large as the looks make them, and of the predicted
        rest, (a, 3, 3) mm2.
        """
        sizes = probabilities @ np.square([one.share for one in HYPOTHESES])
        return error_limit_mm(sizes[:, None, None] * self.arm_mm2 + covariances_mm2, CORRECTION_CONFIDENCE)


def predict_before_looks(
    points_mm: Array, target_mm: Array, arm: Sequence[Source], others: Sequence[Source]
) -> TargetPrediction:
    """Predict a target (3,) mm from looks at points (m, 3) mm that are still to come: by the prior alone."""
    planned = PlannedTarget.of(points_mm, target_mm, arm, others)
    _, parts = planned.correct(np.zeros((1, points_mm.size)), _normalize(PRIOR[None]))
    return planned.predict({name: part[0] for name, part in parts.items()})


def best_influence(points_mm: Array, target_mm: Array, sources: Sequence[Source]) -> Array:
    """Return the influence (m, 3, 3) of looks at points (m, 3) mm that predicts the target (3,) mm best."""
    pose, centre = _pose_columns(points_mm), points_mm.mean(axis=0)
    information = np.linalg.inv(covariance_of(sources))
    common = covariance_with_target(sources).T @ information
    at_target = pose_jacobian(target_mm, centre)
    normal = pose.T @ information @ pose
    missing = np.linalg.solve(normal, (at_target - common @ pose).T).T
    flat = common + missing @ pose.T @ information
    return np.asarray(flat.reshape(AXES, -1, AXES).transpose(1, 0, 2))


def _normalize(log_odds: Array) -> Array:
    """Return the probabilities (a, h) of hypotheses by their log odds."""
    odds = np.exp(log_odds - log_odds.max(axis=1, keepdims=True))
    return np.asarray(odds / odds.sum(axis=1, keepdims=True))


def _pose_columns(points_mm: Array) -> Array:
    return pose_jacobian(points_mm, points_mm.mean(axis=0)).reshape(-1, 6)
