"""Adjustment of many arms in the same poses, as `ArmLearning` adjusts one.

All that depends on the poses alone is computed once: under each hypothesis, the weights of the residuals, the
influence of the looks on every target and the covariance there. A test compares the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import logsumexp

from procedures.registration.arm_learning import (
    HYPOTHESES,
    STATED,
    ArmLearning,
    Looks,
    Source,
    best_influence,
)
from procedures.registration.error_theory import DEFAULT_CONFIDENCE, chi_square_limit, error_limit_mm
from procedures.registration.target_prediction import (
    WIDENED_BEYOND,
    influence_of_spheres,
    predict_by_influence,
)
from ronna_hw.arrays import Array

STATED_NUMBER = HYPOTHESES.index(STATED)


@dataclass(frozen=True)
class TargetSources:
    """Sources at one target (3,) mm: those that scale with the arm's errors, and all others."""

    target_mm: Array
    arm: Sequence[Source]
    others: Sequence[Source]


@dataclass(frozen=True)
class Judged:
    """What `a` arms learned of `t` targets, or a plain registration says of them."""

    shifts_mm: Array  # (a, t, 3)
    covariances_mm2: Array  # (a, t, 3, 3)
    chi_squares: Array  # (a,)
    freedom: int

    def refused(self, confidence: float) -> Array:
        """Mark the arms (a,) whose residual is beyond its limit of this confidence."""
        return np.asarray(self.chi_squares > chi_square_limit(self.freedom, confidence))

    def limits_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> Array:
        """Return the limits (a, t) of the errors, widened where the residual is too large."""
        is_wide = self.chi_squares > chi_square_limit(self.freedom, WIDENED_BEYOND)
        widening = np.where(is_wide, np.sqrt(self.chi_squares / self.freedom), 1.0)
        return widening[:, None] * error_limit_mm(self.covariances_mm2, confidence)


@dataclass(frozen=True)
class PlannedAdjustment:
    """Looks at points (m, 3) mm, prepared under all hypotheses, with the influence on `t` targets."""

    freedom: int
    log_odds: Array  # (h,) of each hypothesis, for residuals of zero
    weights: Array  # (h, 3m, 3m)
    influences: Array  # (t, h, 3, 3m)
    covariances_mm2: Array  # (t, h, 3, 3)
    plain_mm2: Array  # (t, 3, 3) of an unweighted fit, as stated

    @classmethod
    def of(cls, points_mm: Array, targets: Sequence[TargetSources]) -> Self:
        """Prepare looks; the sources of every target are the same at the looks."""
        first = targets[0]
        blank = ArmLearning.of(Looks(np.zeros_like(points_mm), points_mm, first.arm, first.others))
        influences, covariances, plain = [], [], []
        for target in targets:
            sources = [one.sources(target.arm, target.others) for one in HYPOTHESES]
            best = [best_influence(points_mm, target.target_mm, one) for one in sources]
            influences.append([one.transpose(1, 0, 2).reshape(3, -1) for one in best])
            covariances.append(
                [
                    predict_by_influence(influence, one).covariance_mm2
                    for influence, one in zip(best, sources, strict=True)
                ]
            )
            unweighted = influence_of_spheres(points_mm, target.target_mm)
            plain.append(predict_by_influence(unweighted, sources[STATED_NUMBER]).covariance_mm2)
        return cls(
            3 * len(points_mm) - 6,
            np.log(blank.probabilities),
            blank.weights,
            np.array(influences),
            np.array(covariances),
            np.array(plain),
        )

    def learn(self, residuals_mm: Array) -> Judged:
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
        best = odds.argmax(axis=1)
        return Judged(mean, covariances, chi_squares[np.arange(len(flat)), best], self.freedom)

    def judge_plain(self, residuals_mm: Array) -> Judged:
        """Judge an unweighted registration of `a` arms by the sizes as stated."""
        flat = residuals_mm.reshape(len(residuals_mm), -1)
        chi_squares = np.einsum("ai,ij,aj->a", flat, self.weights[STATED_NUMBER], flat)
        shape = (len(flat), *self.plain_mm2.shape)
        return Judged(np.zeros(shape[:-1]), np.broadcast_to(self.plain_mm2, shape), chi_squares, self.freedom)
