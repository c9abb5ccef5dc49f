"""Does a run have the devices of this theatre now? Then no other command opens them."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from procedures.cli.case.request_file import REQUEST_FILE, RequestFile
from procedures.engine.errors import RunInUse, TheatreInUse
from procedures.engine.run_lock import held_run
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.errors import RonnaError

RUN = "run"


@dataclass(frozen=True)
class RunningCase:
    """A run that is under way, and the process that holds its folder."""

    folder: Path
    pid: int

    @property
    def seen(self) -> str:
        """Which run uses the theatre, and its process id."""
        return f"{self.folder.name} (pid {self.pid}) is using this theatre"

    @property
    def advice(self) -> str:
        """What to do instead of ending it; the caller adds when to try again."""
        watch = f"ronna-procedure watch {shlex.quote(str(self.folder))}"
        return f"Leave it alone: its arm may be at a patient. Follow it with {watch}; "

    @property
    def diagnostic(self) -> Diagnostic:
        """As the doctor tells it."""
        seen = f"{self.seen}: its devices were not checked"
        return Diagnostic(RUN, False, seen, f"{self.advice}check again when it has ended.")


def require_no_running_case(theatre: Path) -> None:
    """Raise PRO-043 while a run works with a theatre file, before anyone is asked to prepare anything."""
    if running := running_case(theatre):
        raise TheatreInUse(running.seen, action=f"{running.advice}start again when it has ended.")


def running_case(theatre: Path) -> RunningCase | None:
    """The run that works with a theatre file now, as far as this user may see its process."""
    wanted = theatre.resolve()
    for pid, folder in _open_runs():
        if wanted in _theatres(folder) and _is_held(folder):
            return RunningCase(folder, pid)
    return None


def _open_runs() -> Iterator[tuple[int, Path]]:
    """Run folders that other processes have open."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            for file in (process / "fd").iterdir():
                with contextlib.suppress(OSError):
                    folder = Path(os.readlink(file))
                    if (folder / REQUEST_FILE).is_file() and int(process.name) != os.getpid():
                        yield int(process.name), folder


def _theatres(folder: Path) -> tuple[Path, ...]:
    try:
        request = RequestFile.model_validate_json(read_json_bytes(folder / REQUEST_FILE))
    except (OSError, RonnaError, ValidationError):
        return ()
    return (folder / "theatre" / "theatre.toml" if request.config is None else request.config,)


def _is_held(folder: Path) -> bool:
    try:
        with held_run(folder):
            return False
    except RunInUse:
        return True
