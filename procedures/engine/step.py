"""What a step is, and what it may use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from procedures.engine.case import Case
from procedures.engine.devices import DeviceSet
from procedures.engine.errors import NotConfirmed
from procedures.engine.operator import Operator, Question
from ronna_hw.clock import Clock
from ronna_hw.config import Calibrations, TheatreFile
from ronna_hw.records import Record

Progress = Callable[[float, str], None]  # share done 0..1, what is being done


@dataclass(frozen=True)
class StepKey:
    """One step of the sequence: a name, and a trajectory for the steps that are done for each."""

    name: str
    trajectory: str | None = None

    def __str__(self) -> str:
        return f"{self.name}:{self.trajectory}" if self.trajectory else self.name


@dataclass(frozen=True)
class StepContext:
    """What a step may use: results so far, devices, the theatre's time, the operator."""

    key: StepKey
    case: Case
    theatre: TheatreFile
    calibrations: Calibrations
    devices: DeviceSet
    clock: Clock
    operator: Operator
    trajectories: tuple[str, ...]
    progress: Progress
    record_confirmation: Callable[[Question, bool], None]
    workspace: dict[str, Any] = field(default_factory=dict)  # large inputs that are not results, by name

    def confirm(self, subject: str, value: str) -> None:
        """Have the operator confirm a value, and record both; raises PRO-002 unless the answer is yes."""
        question = Question(subject, value)
        answer = self.operator.confirm(question)
        self.record_confirmation(question, answer)
        if not answer:
            raise NotConfirmed(f"the operator did not confirm: {subject}", got=value)

    def result(self, kind: str) -> Record:
        """A result of this step's trajectory, or one that belongs to none."""
        if self.key.trajectory and self.case.has(kind, self.key.trajectory):
            return self.case.get(kind, self.key.trajectory)
        return self.case.get(kind)


@dataclass(frozen=True)
class Outcome:
    """What a step found: plain numbers, and the records they were made from."""

    payload: dict[str, Any]
    parents: tuple[Record, ...] = ()
    summary: str = ""  # one line for the operator


@dataclass(frozen=True)
class StepSpec:
    """A clinical step: its name in the state chart, what it needs, and its work."""

    name: str
    title: str
    needs: tuple[str, ...]  # kinds of results
    run: Callable[[StepContext], Outcome]
    per_trajectory: bool = False
    needs_all_trajectories: tuple[str, ...] = ()
    moves: bool = False
    preconditions: Callable[[StepContext], tuple[str, ...]] = lambda _context: ()

    def unmet(self, context: StepContext) -> tuple[str, ...]:
        """All preconditions that are not met now, in plain words; empty when the step may begin."""
        case, trajectory = context.case, context.key.trajectory
        missing = [
            f"no result of {kind}"
            for kind in self.needs
            if not (case.has(kind) or (trajectory and case.has(kind, trajectory)))
        ]
        missing += [
            f"no result of {kind} for {item}"
            for kind in self.needs_all_trajectories
            for item in context.trajectories
            if not case.has(kind, item)
        ]
        return tuple(missing) or self.preconditions(context)
