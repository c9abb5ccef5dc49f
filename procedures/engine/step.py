"""The declaration of a step: its place in the order, what it reads, its result, its work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Generic, TypeVar

from procedures.journal.results import StepResult
from procedures.operator.question import Topic

if TYPE_CHECKING:
    from procedures.engine.context import StepContext

R_co = TypeVar("R_co", bound=StepResult, covariant=True)


class Phase(StrEnum):
    """Part of the case a step belongs to: the superstates of the state chart."""

    PREOPERATIVE = "preoperative"
    PREPARATION = "preparation"
    OPERATION = "operation"


class Scope(StrEnum):
    """How often a step is done in a case."""

    CASE = "case"  # once
    LOCALIZATION = "localization"  # as often as the strategy localizes: once, or for each trajectory
    TRAJECTORY = "trajectory"  # for each trajectory


@dataclass(frozen=True)
class StepKey:
    """One step of a case: a name, and the trajectory it is done for, if it is done for one."""

    name: str
    trajectory: str | None = None

    def __str__(self) -> str:
        return f"{self.name}:{self.trajectory}" if self.trajectory else self.name


@dataclass(frozen=True)
class LeftOut:
    """A trajectory that a result leaves out of the case."""

    trajectory: str
    reason: str
    by: StepKey  # the step whose standing result says so; repeated, it may take the trajectory in again


@dataclass(frozen=True)
class Outcome(Generic[R_co]):
    """What came of a step: its result, and one line for the operator."""

    result: R_co
    summary: str = ""


@dataclass(frozen=True)
class StepSpec(Generic[R_co]):
    """A step of a procedure.

    `reads` are the results it needs and may read, of its own trajectory where they belong to one.
    `continues` says that it may only follow the step before it in the case, for the same trajectory, and that
    nothing else may come between. `finishes` says that the work at a target is done with it: what moves later
    voids no result of that trajectory, and nothing more is done for it. `rechecks` says that it checks the
    mounted tool: after a restart, a fault of the arm, or another number at the controller's inputs someone
    may have had that tool in their hands, so the step is run again before the tool is used. `preconditions`
    are checked besides, and say in plain words what is unmet. `asks` are the questions of its course, in
    order; those of its branches are in their table: see `planned_questions`.
    """

    result: type[R_co]
    title: str
    phase: Phase
    run: Callable[[StepContext], Outcome[R_co]]
    scope: Scope = Scope.CASE
    reads: tuple[type[StepResult], ...] = ()
    moves: bool = False
    continues: bool = False
    finishes: bool = False
    rechecks: bool = False
    asks: tuple[Topic, ...] = ()
    preconditions: Callable[[StepContext], tuple[str, ...]] = lambda _context: ()

    @property
    def name(self) -> str:
        """Its name in the state chart, in the journal and on the command line: the kind of its result."""
        return self.result.kind

    @property
    def needs(self) -> tuple[str, ...]:
        """Kinds of the results that must be valid before it can start."""
        return tuple(model.kind for model in self.reads)
