"""The order of a case, derived from its steps and from how often the strategy localizes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import groupby

from procedures.engine.errors import UnknownStep
from procedures.engine.step import LeftOut, Scope, StepKey, StepSpec
from procedures.journal.results import StepResult

Steps = Sequence[StepSpec[StepResult]]
MOST_NEAR = 3  # names of steps that a mistyped one is answered with


@dataclass(frozen=True)
class CaseOrder:
    """The steps of one case in the order in which they are meant to be done."""

    steps: Steps
    trajectories: tuple[str, ...]
    sequence: tuple[StepKey, ...]

    def spec(self, key: StepKey) -> StepSpec[StepResult]:
        """What the step says about itself."""
        return next(step for step in self.steps if step.name == key.name)

    def find(self, name: str) -> StepKey:
        """The step of that name, such as `registration:T1`; raises PRO-005 with what may have been meant."""
        if not name:
            raise UnknownStep(
                "no step is named", action="Name one, such as registration:T1; list shows them."
            )
        names = {str(key): key for key in self.sequence}
        if name in names:
            return names[name]
        near = [one for one in names if one.partition(":")[0] == name]  # it lacks only the trajectory
        near = near or get_close_matches(name, names, n=MOST_NEAR)
        if near:
            raise UnknownStep(f"there is no step {name!r}", action=f"Did you mean {' or '.join(near)}?")
        raise UnknownStep(f"there is no step {name!r}", expected=", ".join(names))

    @property
    def localizations(self) -> tuple[StepKey, ...]:
        """The steps that say where the head is before the arm."""
        return tuple(key for key in self.sequence if self.spec(key).scope is Scope.LOCALIZATION)

    @property
    def checks_of_tool(self) -> tuple[StepKey, ...]:
        """The steps that check the mounted tool."""
        return tuple(key for key in self.sequence if self.spec(key).rechecks)

    @property
    def leads_to_targets(self) -> bool:
        """Whether the arm is brought to targets; a calibration leaves it where it is."""
        return any(step.finishes for step in self.steps)

    def without_names(self, text: str) -> str:
        """Text for the log, with the number of a trajectory for its name: a name may be a patient's."""
        for number, name in enumerate(self.trajectories, start=1):
            text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", str(number), text)
        return text

    def before(self, key: StepKey) -> tuple[StepKey, ...]:
        """The steps that must have been done before `key`: those of other trajectories need not."""
        earlier = self.sequence[: self.sequence.index(key)]
        own = (None, key.trajectory)
        return tuple(one for one in earlier if key.trajectory is None or one.trajectory in own)

    def left_out_at(self, key: StepKey, decisions: Iterable[LeftOut]) -> dict[str, str]:
        """The trajectories that were left out before that step, and why."""
        place = self.sequence.index
        return {one.trajectory: one.reason for one in decisions if place(one.by) < place(key)}

    def continuation(self, key: StepKey | None) -> StepKey | None:
        """The one step that may follow `key`, where nothing else may come between."""
        if key is None or key not in self.sequence[:-1]:
            return None
        following = self.sequence[self.sequence.index(key) + 1]
        return following if self.spec(following).continues else None

    def unmet(
        self, key: StepKey, latest: StepKey | None, stands: Callable[[StepKey], bool]
    ) -> tuple[str, ...]:
        """Why a step may not come now, after `latest`; empty when its turn may be now.

        A step may come when everything before it is valid: next in the order, for another trajectory, or
        again.
        """
        only = self.continuation(latest)
        if only is not None and key != only and not stands(only):
            return (f"only {only} may follow {latest}",)
        if self.spec(key).continues and key != only:
            own = self.before(key)[-1]
            return (f"it must directly follow {own}",)
        for earlier in self.before(key):
            if not stands(earlier):
                return (f"{earlier} comes first",)
        return ()


def order_of(
    steps: Steps, trajectories: Sequence[str], *, localizes_per_trajectory: bool = True
) -> CaseOrder:
    """The order of a case: what is done for each trajectory is done one trajectory at a time."""

    def each(step: StepSpec[StepResult]) -> bool:
        return step.scope is Scope.TRAJECTORY or (
            step.scope is Scope.LOCALIZATION and localizes_per_trajectory
        )

    sequence: list[StepKey] = []
    # Localizing and targeting are blocks of their own even where they are neighbours.
    for (repeated, _), block in groupby(steps, key=lambda step: (each(step), step.scope)):
        names = [step.name for step in block]
        places: Sequence[str | None] = trajectories if repeated else (None,)
        sequence += [StepKey(name, place) for place in places for name in names]
    return CaseOrder(tuple(steps), tuple(trajectories), tuple(sequence))
