"""A run folder opened for reading as arrays: the reader behind `ronna_hw.load_run`."""

from __future__ import annotations

import warnings
from functools import cached_property
from html import escape
from pathlib import Path

from procedures.engine.case import results_of
from procedures.exchange import run_tables
from procedures.exchange.errors import NO_REGISTRATION
from procedures.exchange.recorded_tables import RecordedPictures, RecordedTables, recorded_tables
from procedures.exchange.registration_in_ct import RegistrationInCt, registration_in_ct
from procedures.live.log_tables import read_topic
from procedures.planning.plan_model import Plan
from procedures.reporting.ending import ending_of
from procedures.reporting.outcome import Truth
from procedures.reporting.run_options import RunOptions, find_seed, read_options
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.runs.folders import require_run
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import explain_unreadable, inspect_run
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.evidence.manifest import SEAL_FILE
from ronna_hw.frames import Transform
from ronna_hw.host.files import open_regular
from ronna_hw.loaded_run import RunTable, RunWarning
from ronna_hw.recording.reading_tape import READINGS_FILE, READINGS_FOLDER
from ronna_hw.text import format_names

TAPE = f"{READINGS_FOLDER}/{READINGS_FILE}"
MOST_SHOWN = 5  # notes, of which a run without its pictures has hundreds
OPENING_LEVEL = 3  # of the stack: who called `load_run`
READING_LEVEL = 4  # who read the table, past its property and `functools`


class RunArrays:
    """Run folder as arrays; `ronna_hw.LoadedRun` describes each of them."""

    def __init__(self, folder: Path) -> None:
        """Check every file, and read the journal and the records. Raises CLI-005, PRO-033."""
        require_run(folder)
        found = inspect_run(folder).require_account()
        self.path = folder
        self._reading = RunReading.of(found)
        self._problems = list(map(str, found.problems))
        if not (folder / SEAL_FILE).exists():
            self._problems.append(f"{SEAL_FILE}: missing: no seal confirms the files as the run left them")
        if found.changes:
            changes = format_names(list(map(str, found.changes)))
            warnings.warn(f"{self.name} is not as it was left: {changes}", RunWarning, OPENING_LEVEL)

    def __repr__(self) -> str:
        shown, rest = self.notes[:MOST_SHOWN], self.notes[MOST_SHOWN:]
        more = (f"and {len(rest)} more: run.notes has all",) if rest else ()
        why = filter(None, (self.reason,))
        return "\n  ".join((f"run {self.name}: {self.outcome}", *why, *shown, *more))

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>{self.targets._repr_html_()}"

    @property
    def name(self) -> str:
        return self._reading.run.name

    @property
    def outcome(self) -> str:
        return ending_of(self._reading).word

    @property
    def reason(self) -> str:
        ending = ending_of(self._reading)
        return "" if ending.is_done else ending.account

    @property
    def scene(self) -> str:
        return self._options.scene

    @property
    def seed(self) -> int | None:
        return find_seed(self._reading.run.opened)

    @property
    def strategy(self) -> str:
        return str(self._reading.run.opened.get("strategy") or "")

    @property
    def faults(self) -> tuple[str, ...]:
        return self._options.faults

    @cached_property
    def _options(self) -> RunOptions:
        return read_options(self.path)

    @property
    def notes(self) -> tuple[str, ...]:
        unreadable = (self._explain_unreadable(name) for name in (EVENTS_FILE, TAPE))
        gaps = self._recorded.gaps if "_recorded" in self.__dict__ else ()
        return tuple(dict.fromkeys(filter(None, (*self._problems, *unreadable, *gaps))))

    @cached_property
    def targets(self) -> RunTable:
        return run_tables.targets_table(self._reading, self._reading.truth or Truth())

    @cached_property
    def spheres(self) -> RunTable:
        return run_tables.spheres_table(self._reading.run)

    @cached_property
    def localized(self) -> RunTable:
        return run_tables.localized_table(self._reading.run)

    @cached_property
    def registrations(self) -> RunTable:
        return run_tables.registrations_table(self._reading.run)

    @cached_property
    def budget(self) -> RunTable:
        return run_tables.budget_table(self._reading.run)

    @cached_property
    def motions(self) -> RunTable:
        return run_tables.motions_table(self._reading.run.journal)

    @cached_property
    def events(self) -> RunTable:
        if self._explain_unreadable(EVENTS_FILE):
            return RunTable.of(run_tables.EVENTS, ())
        return run_tables.events_table(self.path)

    @cached_property
    def _recorded(self) -> RecordedTables:
        found = recorded_tables(self.path)
        if found.gaps:
            text = f"strays, looks and pictures of {self.name} are incomplete: {format_names(found.gaps)}"
            warnings.warn(text, RunWarning, READING_LEVEL)
        return found

    def _explain_unreadable(self, name: str) -> str:
        try:
            open_regular(self.path / name).close()
        except FileNotFoundError:
            return f"{name}: missing"
        except OSError as error:
            return f"{name}: {explain_unreadable(error)}"
        return ""

    @property
    def strays(self) -> RunTable:
        return self._recorded.strays

    @property
    def looks(self) -> RunTable:
        return self._recorded.looks

    @property
    def pictures(self) -> RecordedPictures:
        return self._recorded.pictures

    @cached_property
    def plan(self) -> Plan | None:
        checked = results_of(CheckedPlan, self._reading.run.valid_records)
        return checked[-1].result.plan if checked else None

    def robot_from_ct(self, target: str) -> Transform:
        """Return the head's pose by the registration used for a target. Raises EXC-005 if it has none."""
        return self._find_registration(target).result.robot_from_ct.transform

    def registration(self, target: str) -> RegistrationInCt:
        """Return the registration used for a target and its spheres in the CT. Raises EXC-005."""
        return registration_in_ct(self._reading, self._find_registration(target), target)

    def stream(self, topic: str) -> RunTable:
        """Return a topic of the run's log as a table. Raises LIV-005, ARG-001."""
        return read_topic(self.path, topic)

    def _find_registration(self, target: str) -> UsedRegistration:
        used = run_tables.find_registration(self._reading, target)
        if used is None:
            raise self._explain_no_registration(target)
        return used

    def _explain_no_registration(self, target: str) -> RonnaError:
        """Build the error for a target without a registration, which names those that have one."""
        what = f"{self.name} has no registration for a target {target!r}"
        names = [str(name) for name in self.targets.name]
        if registered := [name for name in names if run_tables.find_registration(self._reading, name)]:
            return NO_REGISTRATION(what, expected=f"one of {', '.join(registered)}")
        none = "none of its targets has one" if names else "it has no targets: the plan was not checked"
        return NO_REGISTRATION(
            f"{what}: {none}", got=self.reason or self.outcome, action="run.targets shows how far it came."
        )
