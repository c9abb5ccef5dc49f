"""Script commands from standard input, read ahead so that `stop` overtakes earlier commands."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

STOP = "stop"
READ_AHEAD = 1000  # lines; beyond them the writer waits
LONGEST_LINE = 4096  # bytes; a command with its words has a tenth
TOO_LONG = f"line-of-more-than-{LONGEST_LINE}-bytes"  # in place of a longer line: no command, and no answer


class PipedLines:
    """Script lines from standard input, read ahead so that `stop` alone overtakes earlier commands."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._lines: deque[str] = deque()  # the last is empty at the end of the input
        self._idle = True  # the case waits for a command, or nothing was read yet

    def attach(self, engine: Engine) -> None:
        """Start reading; `stop` goes directly to this engine."""
        threading.Thread(target=self._read, args=(engine,), name="standard input", daemon=True).start()

    def wait_for_line(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` (host time) for a line or the end of input; return whether one arrived."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._lines), timeout_s)

    def readline(self) -> str:
        """Return the next line, or an empty string on every call after the end of input."""
        with self._changed:
            self._idle = True
            self._changed.wait_for(lambda: bool(self._lines))
            line = self._lines.popleft() if self._lines[0] else ""
            self._idle = False
            self._changed.notify_all()
        return line

    def _read(self, engine: Engine) -> None:
        for line in chain(lines_from(sys.stdin.fileno()), [""]):
            with self._changed:
                self._changed.wait_for(lambda: len(self._lines) < READ_AHEAD)
                is_overtaking = line.strip().lower() == STOP and not (self._idle and not self._lines)
                if not is_overtaking:
                    self._lines.append(line)
                    self._changed.notify_all()
            if is_overtaking:
                engine.checkpoint.pause("a stop was ordered on the standard input")
                engine.setting.workcell.stop()


def lines_from(descriptor: int) -> Iterator[str]:
    """Yield lines from a file descriptor.

    Not by `sys.stdin`: a thread that waits in it holds a lock that the end of the program needs.
    """
    line = bytearray()
    while chunk := os.read(descriptor, LONGEST_LINE):
        *ends, rest = chunk.split(b"\n")
        for end in ends:
            yield f"{_text(line + end)}\n"
            line.clear()
        line += rest
        del line[LONGEST_LINE + 1 :]
    if line:
        yield _text(line)


def _text(line: bytearray) -> str:
    return TOO_LONG if len(line) > LONGEST_LINE else line.decode(errors="replace")
