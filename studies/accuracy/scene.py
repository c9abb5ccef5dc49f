"""The phantom in one position, and what all trials there share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.registration.target_prediction import TargetPrediction
from procedures.strategies.catalogue import CANDIDATES, strategy_named
from procedures.strategies.strategy import Strategy
from ronna_hw.arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.frames import Transform
from studies.accuracy.phantom import Markers, Phantom, counts_of, place
from studies.accuracy.postures import Postures, postures
from studies.accuracy.predicting import predictions
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.scenarios import SET_S, Scenario
from studies.accuracy.trials import CT_FLE_MM, Chance, Sizes, target_errors
from studies.campaign.unit import Sums

Array = NDArray[np.float64]

DIGITS = 6  # of an error in mm
BEST = "best"  # per target and number of spheres, the strategy with the smallest predicted error
FROM = tuple(one.name for one in CANDIDATES)


@dataclass(frozen=True)
class Outcome:
    """Error vectors (a, t, c, 3) of all arms, targets, numbers of spheres; predictions by the last two."""

    errors_mm: Array
    predicted: list[list[TargetPrediction]]


@dataclass(frozen=True)
class Scene:
    """A phantom with its markers in position `number`; `counts` spheres are used for a registration."""

    seed: int
    markers: Markers
    number: int
    phantom: Phantom
    robot_from_ct: Transform
    counts: tuple[int, ...]
    own: tuple[Strategy, ...] = ()

    @classmethod
    def of(
        cls, seed: int, phantom: Phantom, markers: Markers, number: int, own: tuple[Strategy, ...] = ()
    ) -> Self:
        """With all numbers of spheres that these markers allow, and user strategies besides ours."""
        return cls(seed, markers, number, phantom, place(number), counts_of(markers), own)

    def planned(self, strategy: str, left: ErrorSizes = UNCALIBRATED) -> Postures:
        """The poses of a strategy here, for arms with these remaining errors. Raises STU-010."""
        own = {one.name: one for one in self.own}
        chosen = own.get(strategy) or strategy_named(strategy)
        return postures(chosen, self.phantom, self.robot_from_ct, left)

    def predicted(
        self, planned: Postures, left: ErrorSizes = UNCALIBRATED, ct_mm: float = CT_FLE_MM
    ) -> list[list[TargetPrediction]]:
        """By number of spheres, then by target."""
        return [
            predictions(planned, self.phantom, self.robot_from_ct, count, left, ct_mm)
            for count in self.counts
        ]

    def chance(self, arms: Sequence[int], *, scan_again: bool = False) -> Chance:
        """The random draws for arms with these numbers."""
        shape = len(self.phantom.trajectories), len(self.phantom.spheres_mm)
        return Chance.draw(self.seed, self.markers, arms, self.number, shape, scan_again=scan_again)

    def errors_mm(
        self,
        arms: RandomArms,
        planned: Postures,
        chance: Chance,
        sizes: Sizes,
        *,
        any_side: bool = False,
    ) -> Array:
        """Error vectors (a, t, c, 3) of all arms, targets and numbers of spheres."""
        return target_errors(
            arms, planned, self.phantom, self.robot_from_ct, chance, self.counts, sizes, any_side=any_side
        )

    def outcomes(
        self,
        strategies: Sequence[str],
        arms: RandomArms,
        chance: Chance,
        scenario: Scenario = SET_S,
        *,
        any_side: bool = False,
    ) -> dict[str, Outcome]:
        """What the strategies do with these arms of set S in a scenario, which they plan and predict for."""
        single = dict.fromkeys(
            (*(FROM if BEST in strategies else ()), *(one for one in strategies if one != BEST))
        )
        found = {}
        for one in single:
            left = scenario.left(one)
            planned, remaining = self.planned(one, left), scenario.of(arms, one)
            found[one] = Outcome(
                self.errors_mm(remaining, planned, chance, scenario.sizes, any_side=any_side),
                self.predicted(planned, left, scenario.ct_mm),
            )
        if BEST in strategies:
            found[BEST] = _best([found[one] for one in FROM])
        return {one: found[one] for one in strategies}

    def trials(
        self,
        arms: Sequence[int],
        strategies: Sequence[str],
        *,
        scenario: Scenario = SET_S,
        scan_again: bool = False,
        any_side: bool = False,
    ) -> Sums:
        """Length of every error in mm: strategy|spheres|arm|target."""
        drawn, chance = RandomArms.draw(self.seed, arms), self.chance(arms, scan_again=scan_again)
        found: Sums = {}
        outcomes = self.outcomes(strategies, drawn, chance, scenario, any_side=any_side)
        for strategy, outcome in outcomes.items():
            lengths = np.linalg.norm(outcome.errors_mm, axis=-1)
            for (arm, target, count), length in np.ndenumerate(lengths):
                key = f"{strategy}|{self.counts[count]}|{arms[arm]}|{target + 1}"
                found[key] = round(float(length), DIGITS)
        return found


def _best(candidates: Sequence[Outcome]) -> Outcome:
    """At each target with each number of spheres the outcome with the smallest predicted error."""
    predicted = [one.predicted for one in candidates]
    chosen = np.array([[[each.rms_mm for each in row] for row in one] for one in predicted]).argmin(axis=0)
    errors_mm = np.stack([one.errors_mm for one in candidates])
    return Outcome(
        np.take_along_axis(errors_mm, chosen.T[None, None, :, :, None], axis=0)[0],
        [[predicted[k][count][target] for target, k in enumerate(row)] for count, row in enumerate(chosen)],
    )
