"""Reopening of runs: read the request, lock and repair the folder, write a missing end."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from procedures.engine.run_folder import close_run
from procedures.engine.setting import ClinicalInput
from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import OF_EVERY_LINE, Entry, Journal, JournalValue, theatre_time_s
from procedures.reporting.kept_truth import drop_unsealed_truth
from procedures.runs.folders import hold_run
from procedures.runs.interrupted_run import InterruptedRun, read_interrupted_run
from procedures.runs.request import RunRequest
from procedures.runs.request_file import read_request
from procedures.runs.theatre_lock import list_last_runs, require_ready_theatre
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import KEPT_TRUTH, reopen_seal
from ronna_hw.host.files import remove_folder, walk
from ronna_hw.records import PARTIAL

PROBE_FILE = ".writable"
PROBE_BYTES = 64 * 1024  # more than the journal lines of a whole recovery


def read_reopened_request(
    folder: Path, *, accept: bool = False, answers: Path | None = None, reuse_answers: bool = False
) -> RunRequest:
    """Read a run's request, with the answers from `answers` or, if `reuse_answers`, from the run itself.

    Raises CLI-001, CFG-001, PRO-026, 031 and 034.
    """
    request = read_request(folder.resolve())
    if answers is None and request.answers is not None:
        if reuse_answers:
            tell("answering from the file given at the start; --answers FILE replaces it")
        else:
            request = replace(request, answers=None)
    if answers is not None:
        from procedures.runs.answers import read_answers

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
def hold_interrupted_run(folder: Path, *, only_leaving: bool = False) -> Iterator[InterruptedRun]:
    """Lock and read an interrupted run.

    With `only_leaving` a change of files on which the way home does not depend is only reported. Raises
    PRO-030 while another program has the run open, PRO-033 if it was changed.
    """
    folder = folder.resolve()
    with hold_run(folder):
        interrupted = read_interrupted_run(folder, only_leaving=only_leaving)
        for change in interrupted.run.changes:
            tell(f"warning: not as the run left it: {change}")
        for contradiction in interrupted.contradictions:
            tell(f"warning: {contradiction}")
        yield interrupted


def require_ready_devices(request: RunRequest, run: Path) -> None:
    """Raise PRO-043 while another program uses the configured devices, PRO-047 as for a new run."""
    if request.config is not None:
        require_ready_theatre(request.config, run, request.roles)


def resumable_run(theatre: Path, run: Path | None = None) -> Path | None:
    """Return the last resumable run on a theatre file's devices, or None if there is none or it is `run`."""
    for last in list_last_runs(theatre):
        if last == run:
            return None
        try:
            read_reopened_request(last)
            found = read_interrupted_run(last, only_leaving=True)
            if not (found.parked or found.untouched):
                return last
        except (RonnaError, OSError):  # of a check, of another version, changed, or gone
            continue
    return None


def prepare_folder(interrupted: InterruptedRun) -> None:
    """Prepare a run's folder for being continued. Raises PRO-003 if it is not writable."""
    folder = interrupted.folder
    _check_writable(folder)
    _remove_half_written(folder)
    if drop_unsealed_truth(folder):
        tell(f"{KEPT_TRUTH} was removed: no seal confirms it")
    if interrupted.run.chain.torn:
        torn = len(interrupted.run.chain.torn)
        tell(f"the last line of the journal is truncated ({torn} bytes): it was set aside")
    reopen_seal(folder, [change.file for change in interrupted.run.changes])


def _check_writable(folder: Path) -> None:
    """Raise PRO-003 if a folder cannot be written, before anything is started in it."""
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
    """Remove partial files of a killed program; they never became part of the run."""
    for path, is_folder, _ in list(walk(folder)):
        if not (path.name.startswith(".") and path.name.endswith(PARTIAL)):
            continue
        if not is_folder:
            path.unlink(missing_ok=True)
        elif not remove_folder(path):  # of a report
            tell(f"{path} could not be removed")


def close_completed_run(
    interrupted: InterruptedRun, clinical: ClinicalInput | None, outcome: str = "done", **more: JournalValue
) -> InterruptedRun:
    """Write the end of a run whose steps are all valid, without moving or querying any device."""
    moment_s = theatre_time_s(interrupted.run.journal[-1])
    folder = interrupted.folder
    journal = Journal.reopen_run(folder, interrupted.run.chain)
    journal.write(Entry.RESTARTED, moment_s, **interrupted.as_plain())
    close_run(folder, journal, moment_s, outcome, clinical, **more)
    return read_interrupted_run(folder)


def rewrite_end(interrupted: InterruptedRun) -> InterruptedRun:
    """Rewrite the end of a closed but unsealed run, listing its unconfirmed files."""
    last = interrupted.run.journal[-1]
    journal = Journal.reopen_run(interrupted.folder, interrupted.run.chain)
    journal.write(Entry.RESTARTED, theatre_time_s(last), **interrupted.as_plain())
    said = {field: value for field, value in last.items() if field not in OF_EVERY_LINE}
    journal.write(Entry.CLOSED, theatre_time_s(last), **said)
    journal.close()
    return read_interrupted_run(interrupted.folder)
