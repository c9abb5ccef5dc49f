"""Runs that have ended or were killed, read back with their results and unfinished step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import dropwhile
from pathlib import Path

from procedures.engine.case import Case, StepKey, Stored
from procedures.engine.case_progress import CaseProgress
from procedures.engine.order import CaseOrder
from procedures.engine.run_folder import step_key
from procedures.journal.journal import ENDS_OF_A_STEP, Entry, JournalValue, Line
from procedures.journal.results import parse_record
from procedures.workcell.arm_history import ArmHistory, fold_history, is_any_arm_out
from ronna_hw.evidence.inspection import Inspection, inspect_run
from ronna_hw.evidence.journal_reading import JournalCorrupt
from ronna_hw.evidence.lost_journal_end import (
    LOST,
    describe_lost_end,
    describe_orphans,
    find_orphans,
    lost_as_plain,
)
from ronna_hw.evidence.manifest import NOT_AS_LEFT
from ronna_hw.evidence.unsealed import UNSEALED, unsealed
from ronna_hw.records import BadRecord, Record


@dataclass(frozen=True)
class InterruptedRun:
    """A run that has ended or was killed, read back from its folder to be resumed."""

    run: Inspection  # its changes are of files on which the way home does not depend
    unsealed: Mapping[str, int | None]  # unconfirmed files, with their length

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.run.folder

    def as_plain(self) -> dict[str, JournalValue]:
        """Return the run's unfinished parts in the form that the continued journal records."""
        plain: dict[str, JournalValue] = {
            "begun": None if self.begun is None else str(self.begun),
            "torn_bytes": len(self.run.chain.torn),
            "orphans": list(self.orphans),
        }
        for name, files in ((NOT_AS_LEFT, self.run.not_as_left), (UNSEALED, self.unsealed)):
            if files:
                plain[name] = dict(files)
        return plain | lost_as_plain(self.run.lost)

    @property
    def has_lost_lines(self) -> bool:
        """Whether lines at the end of the journal are torn or lost."""
        return bool(self.run.chain.torn or self.run.lost)

    @property
    def ever_lost_lines(self) -> bool:
        """Whether the journal has lost its end now, or had when an earlier program resumed the run."""
        restarts = self.run.lines(Entry.RESTARTED)
        return self.has_lost_lines or any(line.get("torn_bytes") or LOST in line for line in restarts)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Lines lost at the end of the journal and records that it does not name, in sentences."""
        lost = (
            f"the journal {describe_lost_end(self.run.lost, len(self.run.journal))}" if self.run.lost else ""
        )
        return tuple(filter(None, (lost, describe_orphans(self.orphans) if self.orphans else "")))

    @property
    def arm(self) -> ArmHistory:
        """Arm and instrument history up to the run's end. Raises PRO-011 for lines of another version."""
        return fold_history(self.run.chain, self.run.lost)

    @property
    def is_any_arm_out(self) -> bool:
        """Whether an arm may be away from home. Raises PRO-011 for lines of another version."""
        return is_any_arm_out(self.run.chain, self.run.lost)

    @property
    def finished(self) -> bool:
        """Whether the run was closed with every step done."""
        last = self.run.journal[-1] if self.run.journal else {}
        return last.get("entry") == Entry.CLOSED and last.get("outcome") == "done"

    @property
    def parked(self) -> bool:
        """Whether the run is finished and every arm is home."""
        return self.finished and not self.is_any_arm_out

    @property
    def why_home_needs_no_device(self) -> str | None:
        """Reason why no device is needed to bring the arm home, or None if devices are needed."""
        if self.parked:
            return "the run is finished: its arm is parked"
        if not self.run.lines(Entry.MOTION) and not self.has_lost_lines:
            return "the run has moved nothing"
        return None

    @property
    def untouched(self) -> bool:
        """Whether the run has no results, motions or lost lines, so that it can start from the beginning."""
        lines = self.run.journal
        lost = bool(lines and self.has_lost_lines)
        done = any(line["entry"] in (Entry.RESULT, Entry.MOTION) for line in lines)
        return not (lost or done or self.orphans)

    @property
    def latest(self) -> StepKey | None:
        """Last completed step, or None. It determines which step may immediately follow."""
        done = self.run.lines(Entry.RESULT)
        return step_key(done[-1]) if done else None

    @property
    def plan_sha256(self) -> str | None:
        """Hash of the plan when the run was last opened, or None if not recorded."""
        hashes = [line["plan_sha256"] for line in self.run.journal if line.get("plan_sha256") is not None]
        return str(hashes[-1]) if hashes else None

    @property
    def theatre_sha256(self) -> str | None:
        """Hash of the theatre file when the run was first opened, or None if not recorded."""
        first = self.run.journal[0] if self.run.journal else {}
        return None if first.get("theatre_sha256") is None else str(first["theatre_sha256"])

    @property
    def begun(self) -> StepKey | None:
        """Step that was running when the program was killed, or None."""
        course = [line for line in self.run.journal if line["entry"] in (Entry.INTENT, *ENDS_OF_A_STEP)]
        return step_key(course[-1]) if course and course[-1]["entry"] == Entry.INTENT else None

    @property
    def orphans(self) -> tuple[str, ...]:
        """Identifiers of records that the journal does not mention; they are kept but not valid."""
        return find_orphans(self.folder, {record.identifier for record in self.run.records})

    def list_unrecorded_work(self, order: CaseOrder, step: str) -> tuple[str, ...]:
        """List trajectories with orphaned records of this step or a later one."""
        without_number = {name.partition("-")[2] for name in self.orphans}

        def is_recorded(trajectory: str) -> bool:
            keys = dropwhile(lambda key: key != StepKey(step, trajectory), order.sequence)
            return any(f"{key.name}-{trajectory}" in without_number for key in keys)

        return tuple(filter(is_recorded, order.trajectories))

    def restore_case(self, order: CaseOrder) -> Case:
        """Restore the case from journal and records. Raises REC-001, REC-003, or PRO-011 if they conflict."""
        case = Case(self.folder, self.run.name)
        course = CaseProgress(order, case)
        records = iter(self.run.records)
        for line in self.run.journal:
            if line["entry"] == Entry.RESULT:
                key, record = step_key(line), next(records)
                if key not in order.sequence:
                    raise BadRecord(f"{record.identifier} belongs to a step that this case does not have")
                _require_superseded(course.records_superseded_by(key), key, line)
                course.accept(key, Stored(record, parse_record(record, order.spec(key).result)))
            elif line["entry"] == Entry.VOIDED:
                key = step_key(line)
                _require_superseded(course.records_voided_by(key), key, line)
                course.void(key)
            elif line["entry"] == Entry.DOUBTED:  # whether they are kept is asked again
                for name in _names(line, "steps"):
                    case.doubt(order.find(name), str(line.get("fault")))
        return case


@dataclass(frozen=True)
class Resumption:
    """How an interrupted run is resumed; `accepted` if a script accepts the findings.

    With `only_leaving` no step is run: the arm goes home, or devices are acknowledged, which `asks` nothing.
    """

    interrupted: InterruptedRun
    accepted: bool
    only_leaving: bool = False
    asks: bool = True


def read_interrupted_run(folder: Path, *, only_leaving: bool = False) -> InterruptedRun:
    """Read a run that is to be resumed.

    Raises PRO-033 if it was changed; with `only_leaving`, if its journal, request or records were.
    """
    found = inspect_run(folder)
    found = found.require_account() if only_leaving else found.require_unchanged()
    return InterruptedRun(found, unsealed(found))


def _require_superseded(superseded: Sequence[Record], key: StepKey, line: Line) -> None:
    if [one.identifier for one in superseded] != list(_names(line, "supersedes")):
        raise JournalCorrupt(f"line {line['sequence']} supersedes results that {key} does not")


def _names(line: Line, field: str) -> tuple[str, ...]:
    names = line.get(field, ())
    return tuple(map(str, names)) if isinstance(names, list) else ()
