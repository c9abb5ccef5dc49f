"""A resumed run: what it was asked for, what it left, and whether it can be written to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from procedures.cli.case.opening import Watcher, opened_case
from procedures.cli.case.request import CalibrationRun, CaseRequest
from procedures.cli.case.request_file import read_request
from procedures.composition.procedure import Resumption
from procedures.engine.closing import close_run
from procedures.engine.context import ClinicalInput
from procedures.engine.engine import Engine
from procedures.engine.left_run import LeftRun, read_left_run
from procedures.engine.run_lock import held_run
from procedures.engine.theatre_lock import last_runs, require_free_theatre
from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import OF_EVERY_LINE, Entry, Journal, JournalValue, theatre_time_s
from procedures.reporting.files import KEPT_TRUTH, drop_unconfirmed_truth
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import remove_folder, walk
from ronna_hw.records import PARTIAL

PROBE_FILE = ".writable"
PROBE_BYTES = 64 * 1024  # more than the journal lines of a whole recovery


def request_of(
    folder: Path, *, accept: bool = False, answers: Path | None = None, as_before: bool = False
) -> CaseRequest | CalibrationRun:
    """What the run was asked for, answered by that file; without one by the run's own, if `as_before`.

    Raises CLI-001, CFG-001, PRO-026, 031 and 034.
    """
    request = read_request(folder.resolve())
    if answers is None and request.answers is not None:
        if as_before:
            tell("answering from the file given at the start; --answers FILE replaces it")
        else:
            request = replace(request, answers=None)
    if answers is not None:
        from procedures.cli.case.answers import read_answers

        request = replace(request, answers=read_answers(answers, request.config))
    if accept and request.config is not None:
        from ronna_hw.config import read_theatre_file
        from ronna_hw.theatre_kind import is_simulated

        if not is_simulated(read_theatre_file(request.config)):
            raise UsageMistake(
                "--accept is for a simulated theatre", action="Omit it: on real devices a person accepts."
            )
    return request


@contextmanager
def held_left_run(folder: Path, *, only_leaving: bool = False) -> Iterator[LeftRun]:
    """What a run left, with its folder held for this program.

    With `only_leaving` the arm is to be freed, and a change of what its way home is not computed from is only
    reported. Raises PRO-030 while another program has it open, PRO-033 for one that was changed.
    """
    folder = folder.resolve()
    with held_run(folder):
        left = read_left_run(folder, only_leaving=only_leaving)
        for change in left.changes:
            tell(f"warning: not as the run left it: {change}")
        yield left


@contextmanager
def opened_left(
    request: CaseRequest | CalibrationRun, folder: Path, watcher: Watcher, resumption: Resumption
) -> Iterator[Engine]:
    """The engine of a run that was left, whatever it is of, before anything is compared."""
    if isinstance(request, CaseRequest):
        opened = opened_case(request, folder, watcher, resumption)
    else:
        from procedures.cli.calibrating.resuming import opened_calibration

        opened = opened_calibration(request, folder, watcher, resumption)
    with opened as engine:
        yield engine


def close_left(
    left: LeftRun, clinical: ClinicalInput | None, outcome: str = "done", **more: JournalValue
) -> LeftRun:
    """Write the end of a run whose every step is valid: nothing is moved for it, and no device is asked."""
    moment_s = theatre_time_s(left.run.journal[-1])
    folder = left.run.path
    journal = Journal.taken_up(folder, left.chain)
    journal.write(Entry.RESTARTED, moment_s, **left.as_plain())
    close_run(folder, journal, moment_s, outcome, clinical, **more)
    return read_left_run(folder)


def close_again(left: LeftRun) -> LeftRun:
    """Write the end of a run again that was closed and not sealed, with what lies there unconfirmed."""
    last = left.run.journal[-1]
    journal = Journal.taken_up(left.run.path, left.chain)
    journal.write(Entry.RESTARTED, theatre_time_s(last), **left.as_plain())
    said = {field: value for field, value in last.items() if field not in OF_EVERY_LINE}
    journal.write(Entry.CLOSED, theatre_time_s(last), **said)
    journal.close()
    return read_left_run(left.run.path)


def require_free_devices(request: CaseRequest | CalibrationRun) -> None:
    """Raise PRO-043 while another program has the real devices of this run."""
    if request.config is not None:
        require_free_theatre(request.config)


def unfinished_on(theatre: Path, run: Path | None = None) -> Path | None:
    """The run that can be resumed and had the devices of a theatre file last, if that is not `run`."""
    for last in last_runs(theatre):
        if last == run:
            return None
        if _can_be_resumed(last):
            return last
    return None


def _can_be_resumed(run: Path) -> bool:
    try:
        request_of(run)
        left = read_left_run(run, only_leaving=True)
        return not (left.parked or left.untouched)
    except (RonnaError, OSError):  # of a check, of another version, changed, or gone
        return False


def make_ready(left: LeftRun) -> None:
    """Before a program continues a run. Raises PRO-003 where the run could not be written."""
    folder = left.run.path
    _check_writable(folder)
    _remove_half_written(folder)
    if drop_unconfirmed_truth(folder):
        tell(f"{KEPT_TRUTH} was removed: no seal confirms it")
    if left.chain.torn:
        tell(f"the last line of the journal is truncated ({len(left.chain.torn)} bytes): it was set aside")


def _check_writable(folder: Path) -> None:
    """Raise PRO-003 before anything is started where the run could not be written."""
    probe = folder / PROBE_FILE
    try:
        try:
            with probe.open("wb") as file:
                file.write(bytes(PROBE_BYTES))
                file.flush()
                os.fsync(file.fileno())
        finally:
            probe.unlink(missing_ok=True)
    except OSError as error:
        raise JournalNotWritable(f"cannot write into {folder}: {error.strerror}") from error


def _remove_half_written(folder: Path) -> None:
    """What a program that was killed had not finished writing was never part of the run."""
    for path, is_folder, _ in list(walk(folder)):
        if not (path.name.startswith(".") and path.name.endswith(PARTIAL)):
            continue
        if not is_folder:
            path.unlink(missing_ok=True)
        elif not remove_folder(path):  # of a report
            tell(f"{path} could not be removed")
