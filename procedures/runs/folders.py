"""Run folders: creation, search, and a lock that admits one program at a time."""

from __future__ import annotations

import fcntl
import os
import secrets
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from procedures.engine.errors import RUN_IN_USE, CommandRefused, TheatreNotNoted
from procedures.journal.journal import JOURNAL_FILE
from procedures.runs.request import CaseProcedure, Measurement, RunRequest
from procedures.runs.request_file import write_request
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.command_line.options import require_folder, require_outside_runs
from ronna_hw.errors import EXIT_USAGE, ConfigurationError, DataError
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.evidence.manifest import RECORDS_FOLDER, REQUEST_FILE
from ronna_hw.host.files import walk
from ronna_hw.host.port_users import find_lock_holder
from ronna_hw.log_output import LOG_FILE
from ronna_hw.recording.flight_recorder import BYTES_FOLDER
from ronna_hw.text import format_count, format_names

# One of them makes a folder a run.
RUN_PARTS = (REQUEST_FILE, JOURNAL_FILE, RECORDS_FOLDER, LOG_FILE, EVENTS_FILE, BYTES_FOLDER)


def new_run_folder(request: RunRequest | None, out: Path, kind: str = "") -> Path:
    """Create the folder `OUT/<id>`, with the request in it if the run can be resumed.

    The id is the moment, the seed of a simulated case and four random hex digits, after the kind if given.
    """
    require_folder(out)
    require_outside_runs(out)
    case = request is not None and isinstance(request.procedure, CaseProcedure)
    seed = f"s{request.seed}-" if case and request is not None and request.seed is not None else ""
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{seed}{secrets.token_hex(2)}"
    folder = out / (f"{kind}-{name}" if kind else name)
    made = folder.with_name(f".{folder.name}")  # a run's folder is never seen without its request
    made.mkdir(parents=True)
    if request is not None and not isinstance(request.procedure, Measurement):
        write_request(request, made)
    return made.rename(folder)


@contextmanager
def run_folder(request: RunRequest, out: Path) -> Iterator[Path]:
    """Create a case's folder; if it was removed during the block, remove its newly created parents too."""
    made = [path for path in (out, *out.parents) if not path.exists()]
    folder = new_run_folder(request, out)
    try:
        yield folder
    finally:
        if not folder.exists():
            for path in made:
                with suppress(OSError):  # another run has begun there meanwhile
                    path.rmdir()


@contextmanager
def hold_run(folder: Path) -> Iterator[None]:
    """Lock a run folder for this program. Raises PRO-030 while another program holds it."""
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = find_lock_holder(file)
            by = "another program" if holder is None else str(holder)
            raise RUN_IN_USE(
                f"{by} has {folder.name} open",
                action=f"Operate it where it runs; to follow it from here: ronna-procedure watch {folder}",
            ) from None
        yield
    finally:
        os.close(file)


def find_runs(folder: Path) -> list[Path]:
    """Return the runs in a folder, oldest first. Raises CLI-005 if the folder does not exist."""
    if not folder.is_dir():
        raise PATH_PROBLEM(f"{folder} is not a folder", expected="a folder of runs")
    return sorted(path for path in folder.iterdir() if path.is_dir() and is_run(path))


def find_folders_of_runs(folder: Path) -> list[Path]:
    """Return the immediate subfolders that contain runs."""
    found = []
    for path in sorted(folder.iterdir()):
        with suppress(OSError):  # such as one that only others may read
            if path.is_dir() and find_runs(path):
                found.append(path)
    return found


def require_run(folder: Path) -> None:
    """Raise CLI-005 if a folder is not a run, naming the runs in it."""
    if is_run(folder):
        return
    if folder.is_dir() and (held := [run.name for run in find_runs(folder)]):
        raise PATH_PROBLEM(
            f"{folder} is not a run; it holds {format_count(len(held), 'run')}: {format_names(held)}",
            action=f"Give one of them: {folder / held[-1]}.",
        )
    is_file = folder.is_file()
    raise PATH_PROBLEM(
        f"{folder} is {'a file, not a run' if is_file else 'not the folder of a run'}",
        expected="a folder with journal.jsonl",
        action=next((f"Give the run's folder: {above}." for above in folder.parents if is_run(above)), None)
        or _suggest_run(folder),
    )


def require_two_runs(first: Path, second: Path) -> None:
    """Raise CLI-005 unless both folders are runs, and not the same one."""
    for folder in (first, second):
        require_run(folder)
    if first.samefile(second):
        raise PATH_PROBLEM(
            f"both are the run {first}",
            expected="two runs, to be compared",
            action=f"Name another; ronna-procedure list {first.parent} shows those beside it.",
        )


def _suggest_run(folder: Path) -> str | None:
    """Name the only run that part of its name, or of its folder's name, may mean."""
    beside = [one for one in folder.parent.glob("*") if one.is_dir()] if folder.name else []
    held: list[Path] = []
    for place in beside:
        with suppress(OSError):  # such as a folder that only others may read
            held += [] if is_run(place) else find_runs(place)
    of_place = [run for run in held if run.parent.name.startswith(folder.name)]
    named = [run for run in (*filter(is_run, beside), *held) if folder.name in run.name]
    for meant in (named, of_place):
        if len(meant) == 1:
            return f"Did you mean {shlex.quote(str(meant[0]))}?"
    return None


def is_run(folder: Path) -> bool:
    """Whether a folder is a run, even with only part of its files."""
    return any((folder / name).exists() for name in RUN_PARTS)


def remove_if_refused(folder: Path, problem: BaseException) -> None:
    """Remove the folder of a run that was refused before anything was recorded."""
    from procedures.workcell.errors import AnotherArm

    refused = isinstance(problem, AnotherArm | ConfigurationError | DataError | TheatreNotNoted) or (
        isinstance(problem, CommandRefused) and problem.exit_code == EXIT_USAGE
    )
    journal = folder / JOURNAL_FILE
    begun = (journal.exists() and journal.stat().st_size) or any((folder / RECORDS_FOLDER).glob("*"))
    if refused and not begun:
        shutil.rmtree(folder, ignore_errors=True)


def remove_if_empty(folder: Path) -> None:
    """Remove a run folder that contains nothing but its request and log."""
    if not any(
        path.is_file() and not path.name.startswith((LOG_FILE, REQUEST_FILE)) for path, *_ in walk(folder)
    ):
        shutil.rmtree(folder, ignore_errors=True)
