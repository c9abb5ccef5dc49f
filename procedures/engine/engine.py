"""Runs steps in their order: intent to the journal, then the work, then the result.

Work happens here, never in a transition of the state chart. Whatever ends a step early stops the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from procedures.engine.case import Case
from procedures.engine.devices import DeviceSet, calibrations_of
from procedures.engine.errors import JournalNotWritable, StepRefused, UnknownStep
from procedures.engine.journal import Entry, Journal
from procedures.engine.machine import ProcedureMachine
from procedures.engine.operator import Operator, Question
from procedures.engine.order import may_follow, sequence_of
from procedures.engine.step import Outcome, Progress, StepContext, StepKey, StepSpec
from ronna_hw.clock import Clock
from ronna_hw.config import TheatreFile
from ronna_hw.errors import RonnaError
from ronna_hw.records import Record

Listener = Callable[[StepKey, Outcome], None]


@dataclass
class Engine:
    """One run of the procedure."""

    steps: Mapping[str, StepSpec]
    trajectories: tuple[str, ...]
    case: Case
    theatre: TheatreFile
    devices: DeviceSet
    clock: Clock
    operator: Operator
    journal: Journal
    progress: Progress = lambda _share, _text: None
    listener: Listener = lambda _key, _outcome: None
    safe_point: Callable[[], None] = lambda: None  # may wait, or raise to end the procedure here
    on_ending: Callable[[], None] = lambda: None  # before the arm is stopped for good
    machine: ProcedureMachine = field(default_factory=ProcedureMachine)
    _latest: StepKey | None = None  # the step that was begun last
    _journalled: set[str] = field(default_factory=set)  # identifiers
    _workspace: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.sequence = sequence_of(self.trajectories)
        self._calibrations = calibrations_of(self.theatre)

    @property
    def upcoming(self) -> StepKey | None:
        """The step that comes next, or None when the case is finished."""
        return next((key for key in self.sequence if not self._stands(key)), None)

    @property
    def finished(self) -> tuple[StepKey, ...]:
        """The steps whose results stand, in order."""
        return tuple(key for key in self.sequence if self._stands(key))

    def find(self, name: str) -> StepKey:
        """The step of that name, such as `registration:T1`; raises PRO-005 with the names that exist."""
        for key in self.sequence:
            if str(key) == name:
                return key
        raise UnknownStep(f"there is no step {name!r}", expected=", ".join(str(key) for key in self.sequence))

    def why_refused(self, key: StepKey) -> tuple[str, ...]:
        """Everything that keeps a step from beginning now; empty when it may begin."""
        reasons = [] if self._may_follow(key) else [f"it may not follow {self._latest or self.machine.state}"]
        return (*reasons, *self.steps[key.name].unmet(self._context(key)))

    def run_step(self, key: StepKey) -> Record:
        """Run one step; raises PRO-001 while it is refused, and whatever the step raises."""
        unmet = self.why_refused(key)
        if unmet or not self.machine.begin(key.name, unmet):
            self._write(Entry.REFUSED, step=str(key), unmet=list(unmet))
            raise StepRefused(f"{key} may not begin: {'; '.join(unmet)}")
        step = self.steps[key.name]
        try:
            self._latest = key
            self._write(Entry.INTENT, step=str(key), moves=step.moves)
            self.operator.announce(str(key))
            outcome = step.run(self._context(key))
            record = self.case.add(key.name, outcome.payload, outcome.parents, key.trajectory)
            self._write(Entry.RESULT, step=str(key), record=record.identifier, sha256=record.sha256)
        except KeyboardInterrupt:
            self.on_ending()
            self.devices.stop()
            self.machine.abort()
            self._write(Entry.INTERRUPTED, step=str(key))
            raise
        except Exception as problem:
            self._fail(key, problem)
            raise
        self._journalled.add(record.identifier)
        if self.upcoming is None:
            self.machine.finish()
        self.listener(key, outcome)
        return record

    def run_to(self, last: StepKey | None = None) -> None:
        """Run the upcoming steps up to and including `last`, or all."""
        while (key := self.upcoming) is not None:
            self.safe_point()
            self.run_step(key)
            if key == last:
                return

    def close(self, outcome: str) -> None:
        """End the sessions and the journal."""
        self.devices.close()
        try:
            self._write(Entry.CLOSED, outcome=outcome)
        except JournalNotWritable:
            pass  # it has been reported where it broke; closing must go on
        finally:
            self.journal.close()

    def _stands(self, key: StepKey) -> bool:
        """Whether a step has a result that is in the journal and has not been superseded."""
        if not self.case.has(key.name, key.trajectory):
            return False
        return self.case.get(key.name, key.trajectory).identifier in self._journalled

    def _may_follow(self, key: StepKey) -> bool:
        return self.machine.may_follow(key.name) and may_follow(key, self._latest)

    def _fail(self, key: StepKey, problem: Exception) -> None:
        self.devices.stop()
        self.machine.fail()
        code = problem.code if isinstance(problem, RonnaError) else type(problem).__name__
        attachments = problem.attachments if isinstance(problem, RonnaError) else {}
        for name, text in attachments.items():
            (self.case.folder / name).write_text(text, encoding="utf-8")
        if not isinstance(problem, JournalNotWritable):
            files = {"files": sorted(attachments)} if attachments else {}
            self._write(Entry.FAILED, step=str(key), code=code, what=str(problem), **files)

    def _context(self, key: StepKey) -> StepContext:
        return StepContext(
            key=key,
            case=self.case,
            theatre=self.theatre,
            calibrations=self._calibrations,
            devices=self.devices,
            clock=self.clock,
            operator=self.operator,
            trajectories=self.trajectories,
            progress=self.progress,
            record_confirmation=self._record_confirmation,
            workspace=self._workspace,
        )

    def _record_confirmation(self, question: Question, answer: bool) -> None:
        self._write(Entry.CONFIRMATION, subject=question.subject, value=question.value, answer=answer)

    def _write(self, entry: Entry, **data: Any) -> None:
        self.journal.write(entry, self.clock.now_s(), **data)
