"""A step's view of the case. Every result that the step reads becomes a parent of its own result."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import chain, count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from procedures.engine.case import Case, StepKey, Stored
from procedures.engine.errors import WRONG_RESULT
from procedures.engine.events import EventStream, Progress, ScanProgress
from procedures.engine.questions import Questions
from procedures.engine.setting import CaseSetting, ClinicalInput
from procedures.journal.results import StepResult
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import YES, Picture, Question, Task, Topic
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import PICTURES_FOLDER, hash_inputs
from ronna_hw.records import Record, write_atomically

if TYPE_CHECKING:
    from procedures.workcell import Workcell

R = TypeVar("R", bound=StepResult)
D = TypeVar("D")


@dataclass(frozen=True)
class StepContext:
    """Interface through which a step accesses its case."""

    key: StepKey
    reads: tuple[type[StepResult], ...]  # results that the step declares to read
    trajectories: tuple[str, ...]
    left_out: Mapping[str, str]  # trajectories that stay left out whatever this step does, and why
    setting: CaseSetting
    _case: Case
    _questions: Questions
    _checkpoint: Checkpoint
    _events: EventStream
    _find: Callable[[str, Sequence[str]], None]
    _void: Callable[[StepKey, RonnaError], None]
    _read: dict[str, Record] = field(default_factory=dict)
    _pictures: dict[str, str] = field(default_factory=dict)
    _inputs: dict[str, str] = field(default_factory=dict)

    def result(self, model: type[R]) -> R:
        """Return the valid result of a model for this step's trajectory or for the whole case.

        A step that declares to read a result derived from that model gets this one, which stands in for it.
        Raises PRO-001 without one, PRO-016 if this step does not declare that it reads it, REC-001 if its
        file was changed.
        """
        return self._read_result(model).result

    def _read_result(self, model: type[R]) -> Stored[R]:
        declared = next((one for one in self.reads if issubclass(one, model)), None)
        if declared is None:
            raise WRONG_RESULT(f"{self.key} asks for {model.kind}, which it does not declare in its reads")
        return self._read_from_case(declared, self.key.trajectory)

    def _read_from_case(self, model: type[R], trajectory: str | None) -> Stored[R]:
        """Read a result, check its file and record it as a parent. Every read goes through here."""
        stored = self._case.get(model, trajectory)
        self._read[stored.record.identifier] = stored.record
        return stored

    def trajectories_done(
        self, model: type[R], accept: Callable[[R], bool] = lambda _result: True
    ) -> tuple[str, ...]:
        """List trajectories with a valid result that passes `accept`, without adding parents."""
        found = ((name, self._case.find(model, name)) for name in self.trajectories)
        return tuple(name for name, one in found if one is not None and accept(one.result))

    @property
    def read(self) -> tuple[Record, ...]:
        """Records read so far, which become parents of this step's result."""
        return tuple(self._read.values())

    @property
    def done_before(self) -> bool:
        return self._case.stands(self.key)

    def doubt(self, model: type[R]) -> str | None:
        """Return the fault that puts a result in doubt, or None; without a declared read, the last result."""
        return self._case.doubt_of(self._read_declared_or_last(model).record)

    def keep(self, model: type[R]) -> None:
        """Clear the doubt about a result; `model` as for `doubt`."""
        self._case.trust(self._read_declared_or_last(model).record)

    def _read_declared_or_last(self, model: type[R]) -> Stored[R]:
        is_declared = any(issubclass(one, model) for one in self.reads)
        return self._read_result(model) if is_declared else self._standing(model)[-1]

    @property
    def trajectory(self) -> str:
        """The trajectory of this step. Raises PRO-016 if it has none."""
        if self.key.trajectory is None:
            raise WRONG_RESULT(f"{self.key} is not a step of one trajectory")
        return self.key.trajectory

    @property
    def served_trajectories(self) -> tuple[str, ...]:
        """Trajectories that this step's result applies to: its own, or all remaining ones."""
        return self.remaining if self.key.trajectory is None else (self.key.trajectory,)

    @property
    def remaining(self) -> tuple[str, ...]:
        """Trajectories that were neither left out nor finished before something moved."""
        gone = {*self.left_out, *self._case.trajectories_finished_before_move}
        return tuple(name for name in self.trajectories if name not in gone)

    @property
    def workcell(self) -> Workcell:
        """Workcell of the case, the only way for a step to acquire images or move the arm."""
        return self.setting.workcell

    @property
    def clinical(self) -> ClinicalInput:
        """CT series, plan and strategy of the case. Raises PRO-016 in a procedure without a patient."""
        if self.setting.clinical is None:
            raise WRONG_RESULT(f"{self.key} needs a case with a patient")
        return self.setting.clinical

    def device(self, name: str, interface: Callable[..., D]) -> D:
        """Return a device of table `[device.NAME]` as `interface`. Raises DEV-007, DEV-008."""
        return self.workcell.device(name, interface)

    def keep_picture(self, name: str, png: bytes, trajectory: str = "") -> Picture:
        """Save a PNG image in the run folder, of a `trajectory` if any, numbered if the name is taken."""
        path = next(path for path in self._numbered(name) if not path.exists())
        path.parent.mkdir(exist_ok=True)
        write_atomically(path, png, exclusive=True)
        self._pictures[path.name] = hashlib.sha256(png).hexdigest()
        return Picture(name=path.name, sha256=self._pictures[path.name], trajectory=trajectory)

    def find_picture(self, name: str, others: Collection[str] = ()) -> Picture | None:
        """Return the latest image that was saved under a name, as it is now; None if there is none.

        `others` are names of other images, which a numbered one may happen to have.
        """
        numbered = takewhile(Path.is_file, self._numbered(name))
        saved = [path for path in numbered if path.name == name or path.name not in others]
        if not saved:
            return None
        return Picture(name=saved[-1].name, sha256=hashlib.sha256(saved[-1].read_bytes()).hexdigest())

    def _numbered(self, name: str) -> Iterator[Path]:
        first = self._case.folder / PICTURES_FOLDER / name
        return chain((first,), (first.with_stem(f"{first.stem}-{number}") for number in count(2)))

    def note_inputs(self, *files: Path) -> None:
        """Record the hashes of input files, so that `verify` detects any later change."""
        self._inputs.update(hash_inputs(self._case.folder, files))

    @property
    def inputs(self) -> dict[str, str]:
        """SHA-256 of each input file noted so far, by file name."""
        return dict(self._inputs)

    @property
    def pictures(self) -> dict[str, str]:
        """SHA-256 of each picture saved so far, by file name."""
        return dict(self._pictures)

    def progress(self, share: float, text: str, scan: ScanProgress | None = None) -> None:
        """Publish progress (0..1) and current activity, then wait here if a pause was requested."""
        self._events.publish(Progress(step=str(self.key), share=share, text=text, scan=scan))
        self._checkpoint.here(f"{self.key}, {text}")

    def watching(self, what: str) -> AbstractContextManager[None]:
        """Monitor the patient during the block as during a motion, although the arm is at rest."""
        return self._checkpoint.watching(what, None)

    def find(self, text: str, targets: Sequence[str] = ()) -> None:
        """Record a finding about `targets` without stopping the case."""
        self._find(text, targets)

    def identifier(self, model: type[R]) -> str:
        """Return the identifier of a valid result; arguments as for `result`."""
        return self._read_result(model).record.identifier

    def result_among(self, model: type[R], pick: Callable[[Sequence[R]], R | None]) -> R | None:
        """Return the result that `pick` selects from all valid results of a model, ordered oldest first.

        It need not be declared in the reads, because there may be none. Only the chosen result becomes a
        parent. See `stands` for which are valid. Raises
        REC-001.
        """
        standing = self._standing(model)
        picked = pick([one.result for one in standing])
        chosen = next((one for one in standing if one.result is picked), None)
        return None if chosen is None else self._read_from_case(model, chosen.record.trajectory).result

    def latest(self, model: type[R]) -> R | None:
        """Return the newest valid result of a model, to compare with or begin from: it becomes no parent."""
        standing = self._standing(model)
        return standing[-1].result if standing else None

    def former(self, model: type[R]) -> tuple[Stored[R], ...]:
        """Return the superseded results of a model, oldest first, to compare with: they become no parents."""
        return self._case.former(model)

    def former_ancestor(self, record: Record, model: type[R]) -> Stored[R]:
        """Return what a superseded record was computed from; it becomes no parent. Raises PRO-001."""
        return self._case.ancestor(record, model)

    def stands(self, model: type[StepResult]) -> bool:
        """Whether any trajectory has a valid result of this model. Adds no parent.

        Results of finished trajectories that were made before something moved do not count.
        """
        return bool(self._standing(model))

    def _standing(self, model: type[R]) -> list[Stored[R]]:
        past = self._case.finished_before_move
        kept = (one for one in self._case.valid_results if one.record.identifier not in past)
        return [Stored(one.record, one.result) for one in kept if isinstance(one.result, model)]

    def void_each(self, model: type[R], reason: RonnaError) -> None:
        """Void the valid result of a step for every trajectory; see `void`."""
        for trajectory in (None, *self.trajectories):
            if self._case.stands(key := StepKey(model.kind, trajectory)):
                self._void(key, reason)

    def void(self, model: type[R], reason: RonnaError) -> None:
        """Void a result and its descendants without a replacement."""
        self._void(StepKey(model.kind), reason)

    def confirm(self, topic: Topic, subject: str, value: str, trajectory: str | None = None) -> None:
        """Ask the operator to confirm a value and record the answer. Raises PRO-002 unless it is yes."""
        self.require_yes(Question(topic, subject, value, trajectory=trajectory))

    def require_yes(self, question: Question, action: str | None = None) -> None:
        """Ask the operator a question and record the answer. Raises PRO-002 unless it is yes."""
        if self._questions.ask_in_time(question) != YES:
            raise NotConfirmed(
                f"the operator did not confirm '{question.subject}'", got=question.value_line, action=action
            )

    def perform_task(self, task: Task) -> tuple[float, ...]:
        """Assign a task to the room staff and record their readings. Raises PRO-002 if any are missing."""
        return self._questions.perform_task(task)

    def rest_drill(self) -> None:
        """Have a drill that may be turning switched off. Raises PRO-002."""
        self._questions.rest_drill()

    def request_instrument_removal(self) -> None:
        """Ask the staff to remove any instrument from the guide. Raises PRO-002 unless confirmed."""
        self._questions.request_instrument_removal()

    def choose(self, question: Question) -> str:
        """Ask the operator a question and record the answer."""
        return self._questions.ask(question).word
