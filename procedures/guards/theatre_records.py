"""The records that a case works with are still those of the theatre file: of calibrations and of tools.

A file that nobody touched is not read again; a touched one is compared by what it says.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ronna_hw.config import TheatreFile, read_theatre_file
from ronna_hw.errors import RonnaError

Stamp = tuple[int, int, int]  # inode, bytes, time of the last change


class UnchangedRecords:
    """A guard. The way out is not held up: it is led by the records that brought the arm there."""

    name = "calibration and tool records"

    def __init__(self, path: Path, began_with: TheatreFile, in_use: Callable[[], bool]) -> None:
        """`in_use` says whether a step works with them, and not for the way out or home."""
        self._path = path
        self._records = _records(began_with)
        self._in_use = in_use
        self._seen: Stamp | None = None  # when it was compared last, and was the same

    def unmet(self) -> str | None:
        """Which record is another one now, or why that cannot be read."""
        if not self._in_use():
            return None
        try:
            seen = self._path.stat()
            stamp = (seen.st_ino, seen.st_size, seen.st_mtime_ns)
            if stamp == self._seen:
                return None
            now = _records(read_theatre_file(self._path))
        except (RonnaError, OSError) as problem:
            return f"{self._path.name} cannot be read: restore it ({problem})"
        names = sorted(name for name in {*self._records, *now} if self._records.get(name) != now.get(name))
        if names:
            return (
                f"{', '.join(names)} in {self._path.name} changed after the case began with it: put the "
                "former file back, or leave, go home and start a new run"
            )
        self._seen = stamp
        return None


def _records(file: TheatreFile) -> dict[str, object]:
    calibrations = {} if file.calibration is None else file.calibration.records
    return {
        **{f"calibration.{name}": record for name, record in calibrations.items()},
        **{f"tools.{name}": record for name, record in file.tools.items()},
    }
