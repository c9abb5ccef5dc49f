"""Registration together with the errors of the arm that measures: one adjustment of all looks of a case.

A look at a sphere of known place says something about the arm in that pose. What the looks say of arm, head
and targets is the adjustment of `arm_adjustment`; this is its result for the residuals of one case, with what
a case asks of it: the size of the arm's errors, the places of the spheres, corrections, moved spheres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from procedures.registration.arm_adjustment import (
    JudgedHypotheses,
    PlannedAdjustment,
    PlannedTarget,
)
from procedures.registration.arm_hypotheses import HYPOTHESES, Source, covariance_of
from procedures.registration.look_checks import CheckedLooks, LookChecks, PassingDisplacements
from procedures.registration.moved_together import MovedTogether
from procedures.registration.target_prediction import (
    AXES,
    IndependentErrors,
    ResidualCheck,
    TargetPrediction,
    UnnoticedPoint,
)
from procedures.registration.tracker_view import TrackerView
from ronna_hw.arrays import Array


@dataclass(frozen=True)
class Looks:
    """Looks at spheres: residuals (m, 3) mm from a nearby pose of the head, points (m, 3) mm there, errors.

    `arm` are the sources that scale with the size of the arm's errors, `others` all the rest. Errors of a
    sphere that several looks share are `SharedErrors`, see `arm_hypotheses.share_by_sphere`.
    """

    residuals_mm: Array
    points_mm: Array
    arm: Sequence[Source]
    others: Sequence[Source]


@dataclass(frozen=True)
class LearnedTarget:
    """Correction (3,) mm of the commanded place of a target, from its place by `from_pose`, and its error.

    A longer correction than `limit_mm` is not explained by what is stated of the arm.
    """

    shift_mm: Array
    prediction: TargetPrediction
    limit_mm: float


@dataclass(frozen=True, eq=False)
class ArmLearning:
    """Adjustment of all looks of one case under each hypothesis, and the probability of each."""

    looks: Looks
    planned: PlannedAdjustment
    judged: JudgedHypotheses  # of this case alone

    @classmethod
    def of(cls, looks: Looks) -> Self:
        """Adjust at least three looks at different spheres."""
        planned = PlannedAdjustment.of(looks.points_mm, looks.arm, looks.others)
        return cls(looks, planned, planned.judge(looks.residuals_mm.reshape(1, -1)))

    @property
    def probabilities(self) -> Array:
        """Probability (h,) of each hypothesis."""
        return np.asarray(self.judged.probabilities[0])

    @property
    def share(self) -> float:
        """Expected size of the arm's errors as a share of the stated ones."""
        return float(self.probabilities @ [one.share for one in HYPOTHESES])

    @property
    def scatter_mm(self) -> float:
        """Expected scatter per axis of the arm beyond its model."""
        return float(self.probabilities @ [one.scatter_mm for one in HYPOTHESES])

    @cached_property
    def acceptable(self) -> ResidualCheck:
        """Residual under the most probable hypothesis that an arm is accepted with, for the gate.

        The largest of these hypotheses would leave less, and explain a moved sphere as well.
        """
        return self._check(self.judged.acceptable)

    @cached_property
    def residual(self) -> ResidualCheck:
        """Residual under the most probable hypothesis."""
        return self._check(self.judged.most_probable)

    def _check(self, chi_squares: Array) -> ResidualCheck:
        return ResidualCheck(float(chi_squares[0]), self.looks.residuals_mm.size - 6)

    def spheres_mm(self, rows: Sequence[Sequence[int]]) -> tuple[Array, Array]:
        """Return the true place (n, 3) mm of each sphere by its looks, and its covariance (n, 3, 3).

        `rows` are the looks at each sphere. The covariance is that of arm and looks, with
        the pose of the head given.
        """
        count, looks = len(rows), len(self.looks.points_mm)
        mean = np.zeros((count, looks))
        for number, own in enumerate(rows):
            mean[number, list(own)] = 1.0 / len(own)
        average = np.kron(mean, np.eye(AXES))
        looked = (self.looks.residuals_mm + self.looks.points_mm).reshape(-1)
        residuals, shared = self.looks.residuals_mm.reshape(-1), covariance_of(self.looks.arm)
        apart = covariance_of([one for one in self.looks.others if isinstance(one, IndependentErrors)])
        place, covariance = np.zeros(AXES * count), np.zeros((AXES * count, AXES * count))
        found = (HYPOTHESES, self.probabilities, self.planned.informations, self.planned.weights)
        for one, probability, information, weight in zip(*found, strict=True):
            arm = one.share**2 * shared
            lacking = one.scatter_mm**2 * np.eye(AXES * looks)
            place += probability * (average @ (looked - arm @ (weight @ residuals)))
            remaining = arm - arm @ information @ arm + apart + lacking
            covariance += probability * (average @ remaining @ average.T)
        blocks = covariance.reshape(count, AXES, count, AXES)
        own_blocks = blocks[np.arange(count), :, np.arange(count)]
        return place.reshape(-1, AXES), np.asarray(0.5 * (own_blocks + own_blocks.transpose(0, 2, 1)))

    def check(self, rows: Sequence[Sequence[int]], confidence: float, view: TrackerView) -> CheckedLooks:
        """Check the looks before the arm is accepted; `rows` are those at each sphere of the `view`."""
        checks = LookChecks.of(self.planned, rows, confidence, view)
        return checks.judge(self.looks.residuals_mm.reshape(1, -1), view.residuals_mm.reshape(1, -1))

    def find_passing(
        self, rows: Sequence[Sequence[int]], confidence: float, most_mm: float
    ) -> PassingDisplacements:
        """Find how far each sphere could be displaced, up to `most_mm`, with all checks passing."""
        checks = LookChecks.of(self.planned, rows, confidence)
        return checks.find_passing(self.looks.residuals_mm.reshape(-1), most_mm)

    def find_unnoticed(
        self,
        passing: PassingDisplacements,
        target_mm: Array,
        arm: Sequence[Source],
        others: Sequence[Source],
    ) -> UnnoticedPoint:
        """Find the sphere whose displacement moves a target (3,) mm furthest with all checks passing.

        The sources are those of the looks, with what they displace at this target. A displacement also
        changes what is learned of the arm: the shift is that of the place commanded.
        """
        planned = PlannedTarget.of(self.looks.points_mm, target_mm, arm, others)
        residuals = self.looks.residuals_mm.reshape(1, -1)
        as_is_mm, _ = planned.correct(residuals, self.judged.probabilities)
        with_it_mm, _ = planned.correct(passing.residuals_mm, passing.probabilities)
        shifts_mm = np.linalg.norm(with_it_mm - as_is_mm, axis=1)
        worst = int(shifts_mm.argmax())
        return UnnoticedPoint(
            int(passing.spheres[worst]), float(passing.lengths_mm[worst]), float(shifts_mm[worst])
        )

    def find_moved_together(self, rows: Mapping[str, Sequence[int]]) -> MovedTogether | None:
        """Find two spheres that likely moved together; `rows` are the looks at each sphere, by its name."""
        residuals = self.looks.residuals_mm.reshape(-1)
        return MovedTogether.find(self.planned, residuals, self.probabilities, rows)

    def at_target(
        self,
        target_mm: Array,
        arm: Sequence[Source],
        others: Sequence[Source],
        moved: MovedTogether | None = None,
    ) -> LearnedTarget:
        """Correct and predict a target (3,) mm, given by the pose that the residuals were taken from.

        The sources are those of the looks, with what they displace at this target. Spheres that likely moved
        add what that does to the target.
        """
        planned = PlannedTarget.of(self.looks.points_mm, target_mm, arm, others)
        residuals = self.looks.residuals_mm.reshape(1, -1)
        shifts, parts = planned.correct(residuals, self.judged.probabilities)
        by_source = {name: part[0] for name, part in parts.items()}
        remaining = np.sum(list(by_source.values()), axis=0)
        limits_mm = planned.limit_corrections_mm(self.judged.probabilities, remaining[None])
        if moved is not None:
            influence = np.einsum("h,hij->ij", self.probabilities, planned.influences)
            by_source[moved.source] = moved.at_target(influence)
        prediction = planned.predict(by_source, self.residual.widening)
        return LearnedTarget(shifts[0], prediction, float(limits_mm[0]))
