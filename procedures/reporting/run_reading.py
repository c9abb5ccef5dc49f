"""Content of a run folder for reporting, with notes on anything unreadable.

A report matters most for the run that went wrong; a truncated journal or a changed file is mentioned in it
and does not prevent the rest from being shown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

from procedures.engine.case import Case, Stored, parent_of_kind, results_of, stand_ins
from procedures.journal.journal import Entry
from procedures.journal.results import StepResult, parse_record
from procedures.reporting.kept_truth import load_sealed_truth
from procedures.reporting.outcome import Truth
from procedures.reporting.run_options import read_options
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import Prediction, RegisteredRobot
from procedures.strategies.names import SCAN_OF_SKIN
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_lines
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import Inspection, inspect_run
from ronna_hw.evidence.lost_journal_end import (
    describe_former_losses,
    describe_lost_end,
    describe_orphans,
    find_orphans,
)
from ronna_hw.evidence.manifest import KEPT_PLAN, KEPT_TRUTH, find_valid_seal
from ronna_hw.log_output import LOG_FILE
from ronna_hw.records import Record
from ronna_hw.text import format_names

MOST_CHANGES = 1000  # that a report lists
MOST_UNREADABLE_LINES = 1000  # of a log: crashes leave a few; a file with nothing else is skipped
R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class RunReading:
    """Content of a run folder, later `changes` to it, and `problems` encountered in reading it.

    `truth` is what the seal confirms of the simulated theatre's verifier.
    """

    run: Inspection
    log: tuple[Mapping[str, Any], ...] = ()  # lines of log.jsonl
    changes: tuple[str, ...] = ()
    problems: list[str] = field(default_factory=list)
    is_sealed: bool = False
    truth: Truth | None = None

    @classmethod
    def of(cls, found: Inspection) -> RunReading:
        """Build the reading of an inspected run, without its log."""
        folder = found.folder
        return cls(found, is_sealed=find_valid_seal(folder) is not None, truth=load_sealed_truth(folder))

    def sealed_with(self, truth: Truth | None) -> RunReading:
        """Return the reading for the program that stores this truth and seals the run next."""
        return replace(self, is_sealed=True, truth=truth)

    @property
    def folder(self) -> Path:
        return self.run.folder

    def valid_results(self, model: type[R]) -> tuple[Stored[R], ...]:
        """Return the valid and readable results of a step, in order."""
        return self._readable(model, self.run.valid_records)

    @property
    def registrations(self) -> tuple[UsedRegistration, ...]:
        """Readable registrations that were or will be used to reach the targets."""
        made = self._readable(RegisteredRobot, self.run.records)
        return find_used_registrations(made, self.run.records, self.run.superseded)

    @property
    def strategies(self) -> dict[str, str]:
        """Readable strategies by target; see `find_used_strategies`."""
        return find_used_strategies(self._readable(CheckedPaths, self.run.records))

    def _readable(self, model: type[R], records: Sequence[Record]) -> tuple[Stored[R], ...]:
        found, models = [], stand_ins(model)
        for record in records:
            if record.kind in models:
                try:
                    found.append(Stored(record, parse_record(record, models[record.kind])))
                except RonnaError as error:
                    self.note(str(error))
        return tuple(found)

    def find(self, model: type[R]) -> R | None:
        """Return the latest valid and readable result of a step, or None."""
        found = self.valid_results(model)
        return found[-1].result if found else None

    def was_scripted(self, topic: str, subject: str = "") -> bool:
        """Whether a script, and nobody, gave the last answer on this topic, or to this question of it."""
        answers = (
            line
            for line in self.run.journal
            if line["entry"] == Entry.CONFIRMATION
            and line.get("topic") == topic
            and subject in ("", line.get("subject"))
        )
        last = deque(answers, maxlen=1)
        options = read_options(self.folder)
        return bool(last and not last[0].get("by")) and options.is_scripted(
            simulated=bool(self.run.opened.get("banner"))
        )

    def note(self, problem: str) -> None:
        """Add a note about something unreliable, without duplicates."""
        if problem not in self.problems:
            self.problems.append(problem)


def read_for_report(folder: Path, *, every_file: bool = True) -> RunReading:
    """Read a run folder for the report. Damaged files never raise errors.

    Without `every_file` only journal, request, records, stored truth and, in a sealed run, its own plan
    are compared, which takes milliseconds.
    """
    plan = (KEPT_PLAN,) if find_valid_seal(folder) is not None else ()
    found = inspect_run(folder, every_file=every_file, files=(KEPT_TRUTH, *plan))
    notes = []
    if not found.chain.lines:
        notes.append("There is no journal: the run ended before its theatre was open.")
    if found.chain.torn:
        notes.append("The last line of the journal is truncated: the program ended while writing it.")
    if found.lost:
        notes.append(_sentence(f"the journal {describe_lost_end(found.lost, len(found.chain.lines))}"))
    named = {Path(name).stem for name in found.manifest.records}
    if found.chain.lines and not found.chain.is_closed and (orphans := find_orphans(folder, named)):
        notes.append(_sentence(describe_orphans(orphans)))
    notes += map(_sentence, describe_former_losses(found.chain.lines))
    changes = tuple(map(str, found.changes[:MOST_CHANGES]))
    if len(found.changes) > MOST_CHANGES:
        notes.append(f"{len(found.changes) - MOST_CHANGES} more changes are not listed; verify lists them.")
    return replace(RunReading.of(found), log=_log(folder), changes=changes, problems=notes)


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _log(folder: Path) -> tuple[Mapping[str, Any], ...]:
    lines: list[Mapping[str, Any]] = []
    unreadable = 0
    try:
        text = read_json_lines(folder / LOG_FILE)
    except (OSError, InputRefused):
        return ()
    for line in BytesIO(text):
        try:
            content = parse_json(line)
        except ValueError:
            unreadable += 1
            if unreadable > MOST_UNREADABLE_LINES:
                break
            continue
        if isinstance(content, dict):
            lines.append(content)
    return tuple(lines)


@dataclass(frozen=True)
class UsedRegistration:
    """Registration with the targets for which it was or will be used."""

    stored: Stored[RegisteredRobot]
    targets: tuple[str, ...]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """Predictions at these targets."""
        return tuple(one for one in self.stored.result.predictions if one.target in self.targets)

    @property
    def result(self) -> RegisteredRobot:
        """The registration result, with only the predictions at these targets."""
        return self.stored.result.model_copy(update={"predictions": self.predictions})


def find_used_registrations(
    registrations: Sequence[Stored[RegisteredRobot]], records: Sequence[Record], gone: Collection[str]
) -> tuple[UsedRegistration, ...]:
    """Find the registrations used in a run, in order. `gone` lists the ids of superseded records.

    A finished target follows the parents of its result, whatever is valid since; any other the valid one.
    """
    used = {
        predicted.target: one.record.identifier
        for one in registrations
        if one.record.identifier not in gone
        for predicted in one.result.predictions
    }
    by_name = {record.identifier: record for record in records}
    for record in records:
        if record.kind != ReachedTarget.kind or record.identifier in gone or record.trajectory is None:
            continue
        positioned = parent_of_kind(record, PositionedGuide, by_name)
        by = positioned and parent_of_kind(positioned, RegisteredRobot, by_name)
        if by is not None:
            used[record.trajectory] = by.identifier
    found = (
        UsedRegistration(one, tuple(name for name, by in used.items() if by == one.record.identifier))
        for one in registrations
    )
    return tuple(one for one in found if one.targets)


def find_used_strategies(checks: Sequence[Stored[CheckedPaths]]) -> dict[str, str]:
    """Find the strategy that each target was last planned with; none for one that was left out.

    A check plans only what is not finished yet, so a finished target keeps the strategy that it was reached
    with. It differs from that of the run where the operator agreed to another, and with `best`.
    """
    used: dict[str, str] = {}
    for one in checks:
        used |= {name: one.result.strategy_of(name) for name in one.result.targets}
        for name in one.result.left_out:
            used.pop(name, None)
    return used


def describe_strategies(strategy: str, used: Mapping[str, str | None]) -> str:
    """Describe the strategy of a run with the targets that used another, such as `ocs (T1 by nos)`.

    Of a case on the skin, that of the scan: no other was used, whichever the run was begun with.
    """
    if used and set(used.values()) == {SCAN_OF_SKIN}:
        return SCAN_OF_SKIN
    by_other: dict[str, list[str]] = {}
    for target, other in used.items():
        if other not in (None, strategy):
            by_other.setdefault(str(other), []).append(target)
    others = "; ".join(f"{format_names(names)} by {other}" for other, names in by_other.items())
    return f"{strategy} ({others})" if others else strategy


def registrations_of(case: Case) -> tuple[UsedRegistration, ...]:
    """Find the registrations used in a case. Raises REC-001, REC-003 for an unreadable record."""
    records, stands = case.records, {one.record.identifier for one in case.valid_results}
    made = results_of(RegisteredRobot, records)
    return find_used_registrations(made, records, {one.identifier for one in records} - stands)
