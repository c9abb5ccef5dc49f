"""A run folder opened for reading as arrays: the reader behind `ronna_hw.load_run`."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from procedures.engine.events.event_file import EVENTS_FILE
from procedures.exchange.errors import NoRegistration
from procedures.exchange.recorded_tables import RecordedPictures, RecordedTables, recorded_tables
from procedures.exchange.run_tables import (
    EVENTS,
    events_table,
    find_registration,
    localized_table,
    motions_table,
    registrations_table,
    spheres_table,
    targets_table,
)
from procedures.reporting.ending import ending_of
from procedures.reporting.outcome import Truth
from procedures.reporting.run_reading import RunReading
from procedures.runs.folders import require_run
from ronna_hw.evidence.inspection import explain_unreadable, inspect_run
from ronna_hw.evidence.manifest import KEPT_TRUTH, SEAL_FILE
from ronna_hw.frames import Transform
from ronna_hw.host.files import open_regular
from ronna_hw.loaded_run import RunTable
from ronna_hw.recording.reading_tape import PIXELS_FILE, READINGS_FILE, READINGS_FOLDER

TAPE = f"{READINGS_FOLDER}/{READINGS_FILE}"
PIXELS = f"{READINGS_FOLDER}/{PIXELS_FILE}"


class RunArrays:
    """Run folder as arrays; `ronna_hw.LoadedRun` describes each of them."""

    def __init__(self, folder: Path) -> None:
        """Check and read the journal and the records. Raises CLI-005, PRO-033."""
        require_run(folder)
        found = inspect_run(folder, every_file=False, files=(KEPT_TRUTH,)).require_account()
        self.path = folder
        self._reading = RunReading.of(found)
        self._found = found
        self._problems = list(map(str, found.problems))
        if not (folder / SEAL_FILE).exists():
            self._problems.append(f"{SEAL_FILE}: missing: no seal confirms the files as the run left them")
        self._note_changes(EVENTS_FILE, TAPE)

    def __repr__(self) -> str:
        return "\n  ".join((f"run {self.name}: {self.outcome}", *self.notes))

    @property
    def name(self) -> str:
        return self._reading.run.name

    @property
    def outcome(self) -> str:
        return ending_of(self._reading).word

    @property
    def notes(self) -> tuple[str, ...]:
        unreadable = (self._explain_unreadable(name) for name in (EVENTS_FILE, TAPE))
        ends_early = self._recorded.ends_early if "_recorded" in self.__dict__ else ""
        return tuple(dict.fromkeys(filter(None, (*self._problems, *unreadable, ends_early))))

    @cached_property
    def targets(self) -> RunTable:
        return targets_table(self._reading, self._reading.truth or Truth())

    @cached_property
    def spheres(self) -> RunTable:
        return spheres_table(self._reading.run)

    @cached_property
    def localized(self) -> RunTable:
        return localized_table(self._reading.run)

    @cached_property
    def registrations(self) -> RunTable:
        return registrations_table(self._reading.run)

    @cached_property
    def motions(self) -> RunTable:
        return motions_table(self._reading.run.journal)

    @cached_property
    def events(self) -> RunTable:
        if self._explain_unreadable(EVENTS_FILE):
            return RunTable.of(EVENTS, ())
        return events_table(self.path)

    @cached_property
    def _recorded(self) -> RecordedTables:
        self._note_changes(PIXELS)  # only here, being most of a run
        return recorded_tables(self.path)

    def _note_changes(self, *names: str) -> None:
        """Note how files differ from their hashes in the journal's last line or in the seal."""
        if self._found.chain.is_closed or (self.path / SEAL_FILE).exists():
            self._problems += map(str, self._found.check_files(names))

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

    def robot_from_ct(self, target: str) -> Transform:
        """Return the registration used for a target. Raises EXC-005 if it has none."""
        used = find_registration(self._reading, target)
        if used is None:
            raise NoRegistration(
                f"{self.name} has no registration for a target {target}",
                expected=f"one of {', '.join(self.targets.name) or 'no targets: the plan was not checked'}",
            )
        return used.result.robot_from_ct.transform
