"""What a case needs of its theatre file and of this computer, before any device is asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from procedures.guards.default_guards import DiskSpace
from ronna_hw.clock import SharedClock, open_clock
from ronna_hw.config import MASTER, TheatreFile
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import require_open_files
from ronna_hw.theatre_kind import is_simulated, require_one_kind

CASE_OPEN_FILES = 96  # as a case requires
CLOCK = "clock of the theatre"
RUNS = Path("runs")  # where a case is written by default
NEEDED = ("tracker", f"robot.{MASTER}", "stereo")


def case_diagnostics(theatre: TheatreFile, out: Path) -> Iterator[Diagnostic]:
    """Everything that keeps a case in a folder of `out` from beginning with any devices and records."""
    kind = "all simulated" if is_simulated(theatre) else "all real"
    yield from _judged("theatre file", kind, lambda: require_one_kind(theatre))
    yield from _judged(CLOCK, f"{theatre.clock.endpoint}", lambda: _read_clock(theatre))
    missing = [name for name in NEEDED if name not in theatre.devices]
    yield Diagnostic(
        "devices of a case",
        not missing,
        f"without {', '.join(missing)}" if missing else ", ".join(NEEDED),
        f"Add {' and '.join(f'[{name}]' for name in missing)} to the theatre file." if missing else "",
    )
    yield from _judged(
        "open files", f"at least {CASE_OPEN_FILES} allowed", lambda: require_open_files(CASE_OPEN_FILES)
    )
    whole = out.resolve()
    folder = next(path for path in (whole, *whole.parents) if path.exists())  # a run makes the others
    full = DiskSpace(folder).unmet()
    found = f"{folder}: {full or 'enough for a case'}"
    yield Diagnostic("disk", full is None, found, "" if full is None else "Free some space.")


def _read_clock(theatre: TheatreFile) -> None:
    """Raises CLK-001."""
    clock = open_clock(theatre.clock.endpoint)
    clock.now_s()
    if isinstance(clock, SharedClock):
        clock.close()


def _judged(subject: str, found: str, require: Callable[[], object]) -> Iterator[Diagnostic]:
    try:
        require()
    except RonnaError as error:
        yield Diagnostic(subject, False, f"{error.code} {error.summary}", error.advice)
    else:
        yield Diagnostic(subject, True, found)
