"""Paths for as many trajectories as can be served: what cannot be reached is put to the operator.

Nothing is replaced or left out without consent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from procedures.engine.context import StepContext
from procedures.operator.question import words
from procedures.planning.free_angle import TurnedPaths, advice, alternatives, choose_free_angles, unreached
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.target_error import with_best_chosen
from procedures.planning.visits import ArmSetting, PathCheck
from procedures.steps.branches import HOLD, LEAVE_OUT, UNREACHABLE, use
from procedures.strategies.by_trajectory import StrategyByTrajectory
from procedures.strategies.strategy import Strategy
from procedures.strategies.trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass
class PathSearch:
    """Searches until everything that remains is reached.

    `centres_mm` (n, 3) are the fiducials in the CT. `left_out` says by trajectory why, `replaced` by which
    strategy it is served instead.
    """

    context: StepContext
    setting: ArmSetting
    centres_mm: Array
    sight: StereoSight
    left_out: dict[str, str] = field(default_factory=dict)
    replaced: dict[str, Strategy] = field(default_factory=dict)
    _tried: dict[str, set[str]] = field(default_factory=dict)

    def paths(self, trajectories: Sequence[Trajectory]) -> TurnedPaths:
        """The paths of what remains; raises PLAN-007 for what cannot be reached when nothing is agreed."""
        self.setting = with_best_chosen(self.setting, trajectories, self.centres_mm, self.sight)
        while True:
            remain = [one for one in trajectories if one.identifier not in self.left_out]
            turned = choose_free_angles(self._setting(), remain, self.centres_mm, self.sight)
            if turned.check.passed:
                return turned
            self._decide(turned.check, remain)

    def _setting(self) -> ArmSetting:
        if not self.replaced:
            return self.setting
        return replace(self.setting, strategy=StrategyByTrajectory(self.setting.strategy, self.replaced))

    def _decide(self, check: PathCheck, trajectories: Sequence[Trajectory]) -> None:
        reasons = unreached(check, trajectories)
        would = {one.identifier: self._alternatives(one) for one in trajectories if one.identifier in reasons}
        others = [one.identifier for one in trajectories if one.identifier not in reasons]
        for name, reason in reasons.items():
            self._ask(check, name, reason, would, others)

    def _ask(
        self,
        check: PathCheck,
        name: str,
        reason: str,
        would: dict[str, tuple[Strategy, ...]],
        others: Sequence[str],
    ) -> None:
        """Another strategy, without this trajectory, or not at all. Raises PLAN-007 when it is not at all."""
        # One registration for all cannot be made by two strategies.
        offered = would[name] if self.setting.strategy.localizes_per_trajectory else ()
        answers = (*(use(one.name) for one in offered), *((LEAVE_OUT,) if others else ()), HOLD)
        if answers == (HOLD,):
            check.require(advice(would))
        now = self.replaced.get(name, self.setting.strategy)
        served = f"; {words([one.name for one in would[name]])} would reach it" if would[name] else ""
        remain = f"; {', '.join(others)} would remain without it" if others else ""
        question = UNREACHABLE.question(
            f"{name} cannot be reached with {now.name} at any angle about its axis",
            f"{reason}{served}{remain}",
            name,
            answers,
        )
        answer = self.context.choose(question)
        agreed = [one for one in offered if answer == use(one.name)]
        if agreed:
            self._tried.setdefault(name, set()).add(agreed[0].name)
            self.replaced[name] = agreed[0]
        elif answer == LEAVE_OUT:
            self.left_out[name] = reason
            self.replaced.pop(name, None)
        else:
            check.require(advice(would))

    def _alternatives(self, trajectory: Trajectory) -> tuple[Strategy, ...]:
        tried = self._tried.get(trajectory.identifier, set())
        return alternatives(self.setting, trajectory, self.centres_mm, self.sight, tried)
