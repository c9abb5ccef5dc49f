"""Step declarations and the step order of a case, derived from its steps and strategy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby
from typing import Generic, TypeVar

from procedures.engine.case import Exclusion, StepKey
from procedures.engine.context import StepContext
from procedures.engine.errors import UnknownStep
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from ronna_hw.near_names import find_near

R_co = TypeVar("R_co", bound=StepResult, covariant=True)
MOST_NEAR = 3  # names of steps that a mistyped one is answered with


class Phase(StrEnum):
    """Phase of a case: group of steps and superstate in the state chart."""

    PREOPERATIVE = "preoperative"
    PREPARATION = "preparation"
    OPERATION = "operation"


class Scope(StrEnum):
    """Scope of a step: once per case or once per trajectory."""

    CASE = "case"  # once
    LOCALIZATION = "localization"  # as often as the strategy localizes: once, or for each trajectory
    TRAJECTORY = "trajectory"  # for each trajectory


@dataclass(frozen=True)
class Outcome(Generic[R_co]):
    """Outcome of a step: result and a one-line summary for the operator."""

    result: R_co
    summary: str = ""


@dataclass(frozen=True)
class StepSpec(Generic[R_co]):
    """Declaration of a procedure step.

    `reads` are the results it needs and may read, of its own trajectory where they belong to one.
    `continues` says that it may only follow the step before it in the case, for the same trajectory, and that
    nothing else may come between. `finishes` says that the work at a target is done with it: what moves later
    voids no result of that trajectory, and nothing more is done for it. `rechecks` says that it checks the
    mounted tool: after a restart, a fault of the arm, or another number at the controller's inputs someone
    may have had that tool in their hands, so the step is run again before the tool is used. `relates_arms`
    says that it measures two arms against each other: a fault of either puts it in doubt. `moves` says that
    it moves the arm from where it is, `others_move` that other arms move while it stays.
    `preconditions` are checked besides, and say in plain words what is unmet. `asks` are the questions of its
    course, in order; those of its branches are in their table: see `list_questions`.
    """

    result: type[R_co]
    title: str
    phase: Phase
    run: Callable[[StepContext], Outcome[R_co]]
    scope: Scope = Scope.CASE
    reads: tuple[type[StepResult], ...] = ()
    moves: bool = False
    others_move: bool = False
    continues: bool = False
    finishes: bool = False
    rechecks: bool = False
    relates_arms: bool = False
    asks: tuple[Topic, ...] = ()
    preconditions: Callable[[StepContext], tuple[str, ...]] = lambda _context: ()

    @property
    def name(self) -> str:
        """Step name in the state chart, the journal and commands; equals the kind of its result."""
        return self.result.kind

    @property
    def moves_an_arm(self) -> bool:
        """Whether anything moves in the step."""
        return self.moves or self.others_move

    @property
    def needs(self) -> tuple[str, ...]:
        """Kinds of results that must be valid before the step can start."""
        return tuple(dict.fromkeys(model.kind for model in self.reads))


Steps = Sequence[StepSpec[StepResult]]


@dataclass(frozen=True)
class CaseOrder:
    """Planned sequence of steps in one case."""

    steps: Steps
    trajectories: tuple[str, ...]
    sequence: tuple[StepKey, ...]

    def spec(self, key: StepKey) -> StepSpec[StepResult]:
        return next(step for step in self.steps if step.name == key.name)

    def find(self, name: str) -> StepKey:
        """Look up a step such as `registration:T1`. Raises PRO-005, suggesting similar names."""
        if not name:
            raise UnknownStep(
                "no step is named", action="Name one, such as registration:T1; list shows them."
            )
        names = {str(key): key for key in self.sequence}
        if name in names:
            return names[name]
        step, _, trajectory = name.partition(":")
        if step in names and trajectory in self.trajectories:
            raise UnknownStep(
                f"there is no step {name!r}: one {step} serves all trajectories", action=f"Name {step}."
            )
        candidates = [one for one in names if one.partition(":")[0] == name]  # it lacks only the trajectory
        candidates = candidates or find_near(name, names, MOST_NEAR)
        if candidates:
            raise UnknownStep(f"there is no step {name!r}", action=f"Did you mean {' or '.join(candidates)}?")
        raise UnknownStep(f"there is no step {name!r}", expected=", ".join(names))

    @property
    def localizations(self) -> tuple[StepKey, ...]:
        """Steps that locate the head in front of the arm."""
        return tuple(key for key in self.sequence if self.spec(key).scope is Scope.LOCALIZATION)

    @property
    def checks_of_tool(self) -> tuple[StepKey, ...]:
        """Steps that check the mounted tool."""
        return tuple(key for key in self.sequence if self.spec(key).rechecks)

    @property
    def relations_of_arms(self) -> tuple[StepKey, ...]:
        """Steps that measure two arms against each other."""
        return tuple(key for key in self.sequence if self.spec(key).relates_arms)

    @property
    def leads_to_targets(self) -> bool:
        """Whether steps lead the arm to targets, as opposed to a calibration."""
        return any(step.finishes for step in self.steps)

    def without_names(self, text: str) -> str:
        """Replace trajectory names by numbers for the log, since a name may identify a patient."""
        numbers = {name: str(number) for number, name in enumerate(self.trajectories, start=1)}
        if not numbers:
            return text
        names = "|".join(map(re.escape, sorted(numbers, key=len, reverse=True)))
        return re.sub(rf"(?<!\w)(?:{names})(?!\w)", lambda found: numbers[found[0]], text)

    def before(self, key: StepKey) -> tuple[StepKey, ...]:
        """Return the steps required before `key`; those of other trajectories do not count."""
        earlier = self.sequence[: self.sequence.index(key)]
        own = (None, key.trajectory)
        return tuple(one for one in earlier if key.trajectory is None or one.trajectory in own)

    def exclusions_at(self, key: StepKey, decisions: Iterable[Exclusion]) -> dict[str, str]:
        """Return the trajectories that earlier steps excluded from a step, with reasons."""
        place = self.sequence.index
        return {one.trajectory: one.reason for one in decisions if place(one.by) < place(key)}

    def continuation(self, key: StepKey | None) -> StepKey | None:
        """Return the step that must directly follow `key`, or None."""
        if key is None or key not in self.sequence[:-1]:
            return None
        following = self.sequence[self.sequence.index(key) + 1]
        return following if self.spec(following).continues else None

    def unmet(
        self, key: StepKey, latest: StepKey | None, stands: Callable[[StepKey], bool]
    ) -> tuple[str, ...]:
        """Return why a step may not directly follow `latest`; empty if it may.

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
    """Derive a case's step order, completing each block of steps for one trajectory before the next."""

    def is_repeated(step: StepSpec[StepResult]) -> bool:
        return step.scope is Scope.TRAJECTORY or (
            step.scope is Scope.LOCALIZATION and localizes_per_trajectory
        )

    sequence: list[StepKey] = []
    # Localizing and targeting are blocks of their own even where they are neighbours.
    for (repeated, _), block in groupby(steps, key=lambda step: (is_repeated(step), step.scope)):
        names = [step.name for step in block]
        places: Sequence[str | None] = trajectories if repeated else (None,)
        sequence += [StepKey(name, place) for place in places for name in names]
    return CaseOrder(tuple(steps), tuple(trajectories), tuple(sequence))
