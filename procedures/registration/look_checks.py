"""Checks that looks must pass before an arm learned from them is accepted.

Residuals that no accepted hypothesis explains, errors of the arm larger than it is accepted with, and spheres
that have more probably moved than not. They judge what an adjustment found and change nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.registration.arm_adjustment import PlannedAdjustment
from procedures.registration.arm_hypotheses import HYPOTHESES, LARGEST_SHARE
from procedures.registration.error_theory import chi_square_limit
from procedures.registration.moved_sphere import MovedSpheres, MovedSphereTest
from procedures.registration.target_prediction import AXES, spread_directions
from procedures.registration.tracker_view import TrackerView
from ronna_hw.arrays import Array

SHARES = np.array([one.share for one in HYPOTHESES])
DIRECTIONS = 100  # of a displacement, both ways each: 13 degrees apart, the worst is missed by 3 % at most
HALVINGS = 6  # of the largest displacement: to 0.05 of 3 mm


@dataclass(frozen=True, eq=False)
class CheckedLooks:
    """Findings of the checks for `a` arms."""

    probabilities: Array  # (a, h) of the hypotheses
    chi_squares: Array  # (a,) under the most probable hypothesis that an arm is accepted with
    freedom: int
    limit: float  # of chi-square
    shares: Array  # (a,) expected size of the arm's errors, as a share of the stated ones
    moved: MovedSpheres

    @property
    def passed(self) -> NDArray[np.bool_]:
        """Mark the arms (a,) that pass every check."""
        return np.asarray(
            (self.chi_squares <= self.limit) & (self.shares <= LARGEST_SHARE) & ~self.moved.is_probable
        )


@dataclass(frozen=True, eq=False)
class LookChecks:
    """Checks of looks (m,), before any residuals."""

    planned: PlannedAdjustment
    rows: tuple[tuple[int, ...], ...]  # looks at each sphere
    test: MovedSphereTest
    freedom: int  # of chi-square
    limit: float

    @classmethod
    def of(
        cls,
        planned: PlannedAdjustment,
        rows: Sequence[Sequence[int]],
        confidence: float,
        view: TrackerView | None = None,
    ) -> Self:
        """Prepare the checks; `rows` are the looks at each sphere, `confidence` is that of chi-square.

        The tracker's `view` is of the same spheres.
        """
        freedom = planned.weights.shape[-1] - 6
        return cls(
            planned,
            tuple(tuple(one) for one in rows),
            MovedSphereTest.of(planned, rows, view),
            freedom,
            chi_square_limit(freedom, confidence),
        )

    def judge(self, residuals_mm: Array, seen_mm: Array | None = None) -> CheckedLooks:
        """Check residuals (a, 3m) of arms, with those (a, 3n) of the tracker's view if it was prepared."""
        judged = self.planned.judge(residuals_mm)
        return CheckedLooks(
            judged.probabilities,
            judged.acceptable,
            self.freedom,
            self.limit,
            judged.probabilities @ SHARES,
            self.test.judge(residuals_mm, judged.probabilities, seen_mm),
        )

    def find_passing(self, residuals_mm: Array, most_mm: float) -> PassingDisplacements:
        """Find how far each sphere could be displaced in every direction with these residuals (3m,) passing.

        If a sphere did move and the residuals without that pass too, its displacement is among these: the
        search inverts the checks. Each is rounded up to the next length tried, up to `most_mm`. The sphere
        may move after the tracker's look, so the looks alone are asked.
        """
        half = spread_directions(DIRECTIONS)
        directions = np.concatenate([half, -half])
        spheres = np.repeat(np.arange(len(self.rows)), len(directions))
        looks = len(residuals_mm) // AXES
        units = np.zeros((len(spheres), looks, AXES))
        for number, own in enumerate(self.rows):
            units[np.ix_(spheres == number, list(own))] = directions[:, None]
        flat = units.reshape(len(spheres), -1)
        passing_mm, failing_mm = np.zeros(len(spheres)), np.full(len(spheres), most_mm)
        tried_mm = failing_mm
        for _ in range(HALVINGS + 1):
            passed = self.judge(residuals_mm + tried_mm[:, None] * flat).passed
            passing_mm = np.where(passed, tried_mm, passing_mm)
            failing_mm = np.where(passed, failing_mm, tried_mm)
            tried_mm = 0.5 * (passing_mm + failing_mm)
        residuals = residuals_mm + failing_mm[:, None] * flat
        return PassingDisplacements(
            spheres, failing_mm, residuals, self.planned.judge(residuals).probabilities
        )


@dataclass(frozen=True, eq=False)
class PassingDisplacements:
    """Longest displacements (d,) of single spheres that pass the checks, by direction."""

    spheres: NDArray[np.intp]  # (d,) place of each among the spheres
    lengths_mm: Array  # (d,)
    residuals_mm: Array  # (d, 3m) with it
    probabilities: Array  # (d, h) of the hypotheses with it
