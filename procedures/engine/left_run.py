"""A run as it ended or broke off: which results stand, what was done last, what had begun and never ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from procedures.engine.case import Case, Stored
from procedures.engine.course import Course
from procedures.engine.order import CaseOrder
from procedures.engine.run_folder import RunFolder, run_of, typed
from procedures.engine.step import StepKey
from procedures.journal.journal import ENDS_OF_A_STEP, JOURNAL_FILE, Entry, JournalValue, Line
from procedures.workcell.arm_history import ArmHistory, history_left_by
from ronna_hw.evidence.inspection import Problem, inspected
from ronna_hw.evidence.journal_reading import Chain, JournalCorrupt
from ronna_hw.evidence.manifest import NOT_AS_LEFT, RECORDS_FOLDER
from ronna_hw.evidence.unsealed import UNSEALED, unsealed
from ronna_hw.records import BadRecord, Record


@dataclass(frozen=True)
class LeftRun:
    """What the folder of a run holds."""

    run: RunFolder
    chain: Chain
    changes: tuple[Problem, ...] = ()  # of its folder, that do not keep an arm from leaving
    not_as_left: Mapping[str, str | None] = field(default_factory=dict)  # those files, with their hashes
    unsealed: Mapping[str, int] = field(
        default_factory=dict
    )  # files that nothing confirms, with their length

    @property
    def has_journal(self) -> bool:
        """Whether the file of the journal is there, with or without a whole line in it."""
        return (self.run.path / JOURNAL_FILE).exists()

    def as_plain(self) -> dict[str, JournalValue]:
        """For the journal that goes on: what was left unfinished."""
        plain: dict[str, JournalValue] = {
            "begun": None if self.begun is None else str(self.begun),
            "torn_bytes": len(self.chain.torn),
            "orphans": list(self.orphans),
        }
        files = {NOT_AS_LEFT: self.not_as_left, UNSEALED: self.unsealed}
        return plain | {field: dict(named) for field, named in files.items() if named}

    @property
    def arm(self) -> ArmHistory:
        """How it left arm and instrument. Raises PRO-011 for a line that another version wrote."""
        return history_left_by(self.chain)

    @property
    def finished(self) -> bool:
        """Whether it was closed with every step done."""
        last = self.run.journal[-1] if self.run.journal else {}
        return last.get("entry") == Entry.CLOSED and last.get("outcome") == "done"

    @property
    def parked(self) -> bool:
        """Whether it is finished, and its arm home."""
        return self.finished and not self.arm.place.is_out

    @property
    def untouched(self) -> bool:
        """Whether it is begun anew: it left no result, and moved nothing, also by a line that was torn."""
        lines = self.run.journal
        torn = bool(lines and self.chain.torn)
        return not torn and not any(line["entry"] in (Entry.RESULT, Entry.MOTION) for line in lines)

    @property
    def latest(self) -> StepKey | None:
        """The step that was done last, where a step that may only follow it may come yet."""
        done = self.run.lines(Entry.RESULT)
        return step_key(done[-1]) if done else None

    @property
    def plan_sha256(self) -> str | None:
        """Of the plan as it was held when the run was opened last; None where no line says it."""
        hashes = [line["plan_sha256"] for line in self.run.journal if line.get("plan_sha256") is not None]
        return str(hashes[-1]) if hashes else None

    @property
    def begun(self) -> StepKey | None:
        """The step that was running when the program was killed."""
        course = [line for line in self.run.journal if line["entry"] in (Entry.INTENT, *ENDS_OF_A_STEP)]
        return step_key(course[-1]) if course and course[-1]["entry"] == Entry.INTENT else None

    @property
    def orphans(self) -> tuple[str, ...]:
        """Records that were written and never came into the journal: they are not valid, and are kept."""
        named = {record.identifier for record in self.run.records}
        folder = self.run.path / RECORDS_FOLDER
        return tuple(sorted(path.stem for path in folder.glob("*.json") if path.stem not in named))

    def restored(self, order: CaseOrder) -> Case:
        """The case as it stood. Raises REC-001, REC-003 for a record, PRO-011 for a contradiction."""
        case = Case(self.run.path, self.run.name)
        course = Course(order, case)
        records = iter(self.run.records)
        for line in self.run.journal:
            if line["entry"] == Entry.RESULT:
                key, record = step_key(line), next(records)
                if key not in order.sequence:
                    raise BadRecord(f"{record.identifier} belongs to a step that this case does not have")
                _require_superseded(course.superseded_by(key), key, line)
                course.accept(key, Stored(record, typed(record, order.spec(key).result)))
            elif line["entry"] == Entry.VOIDED:
                key = step_key(line)
                _require_superseded(course.voided_with(key), key, line)
                course.void(key)
            elif line["entry"] == Entry.DOUBTED:  # whether they are kept is asked again
                for name in _names(line, "steps"):
                    case.doubt(order.find(name), str(line.get("fault")))
        return case


def read_left_run(folder: Path, *, only_leaving: bool = False) -> LeftRun:
    """Read a run that is to be resumed; one without a journal has none of all that.

    Raises PRO-033 for one that was changed; with `only_leaving` for one whose journal, request or records
    were.
    """
    found = inspected(folder)
    found = found.require_account() if only_leaving else found.require_unchanged()
    return LeftRun(run_of(found), found.chain, found.changes, found.not_as_left, unsealed(found))


def step_key(line: Line) -> StepKey:
    """The step that a line is about."""
    name, _, trajectory = str(line.get("step", "")).partition(":")
    return StepKey(name, trajectory or None)


def _require_superseded(gone: Sequence[Record], key: StepKey, line: Line) -> None:
    if [one.identifier for one in gone] != list(_names(line, "supersedes")):
        raise JournalCorrupt(f"line {line['sequence']} supersedes results that {key} does not")


def _names(line: Line, field: str) -> tuple[str, ...]:
    names = line.get(field, ())
    return tuple(map(str, names)) if isinstance(names, list) else ()
