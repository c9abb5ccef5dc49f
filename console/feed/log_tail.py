"""The end of a run's log, re-read when it has grown."""

from __future__ import annotations

from pathlib import Path

from ronna_hw.bounded_input import parse_json
from ronna_hw.host.files import open_regular
from ronna_hw.log_output import LOG_FILE

TAIL_BYTES = 16_384  # about eighty lines
HEADS = ("timestamp", "level", "event")  # shown before a line's other fields


class LogTail:
    """One file for all pages."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOG_FILE
        self._size = -1
        self._lines: tuple[str, ...] = ()

    def lines(self) -> tuple[str, ...]:
        """The last lines as text, oldest first; empty if there is no log."""
        try:
            size = self._path.stat().st_size
            if size != self._size:
                self._size, self._lines = size, self._read(size)
        except OSError:
            self._size, self._lines = -1, ()
        return self._lines

    def _read(self, size: int) -> tuple[str, ...]:
        with open_regular(self._path) as file:
            file.seek(max(0, size - TAIL_BYTES))
            content = file.read(TAIL_BYTES)
        first, *rest = content.split(b"\n")
        whole = rest[:-1] if size > TAIL_BYTES else [first, *rest[:-1]]  # the first may be incomplete
        return tuple(text for line in whole if (text := _as_text(line)))


def _as_text(line: bytes) -> str:
    """`10:21:05 info step begins: part engine, step ct_import`; empty for a line that is not a log line."""
    try:
        content = parse_json(line)
        time, level, event = (str(content.pop(name, "")) for name in HEADS)
        more = ", ".join(f"{name} {value}" for name, value in content.items() if name != "versions")
    except (ValueError, AttributeError, TypeError):
        return ""
    return f"{time[11:19]} {level} {event}{f': {more}' if more else ''}"
