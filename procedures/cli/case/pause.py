"""Ctrl-C on a terminal: once pauses at the next safe point, twice stops now.

Safe points are between steps: the arm rests and every result is recorded. Without a terminal nothing is
changed: one signal ends the command.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import termios
from collections.abc import Iterator
from types import FrameType

from procedures.engine.errors import OperatorAborted
from ronna_hw.command_line.console import on_terminal, tell

STANDARD_ERROR = 2


class Pause:
    """Whether the operator has asked for a pause."""

    def __init__(self) -> None:
        self._wanted = False

    @property
    def wanted(self) -> bool:
        """True between the first Ctrl-C and the rest."""
        return self._wanted

    def clear(self) -> None:
        """Forget that a pause was asked for: it has been had."""
        self._wanted = False

    def ask(self) -> None:
        """Ask once for a pause; the second time raise KeyboardInterrupt."""
        if self._wanted:
            raise KeyboardInterrupt
        self._wanted = True
        # This runs inside a signal handler: the buffered streams may be in the middle of a write.
        os.write(STANDARD_ERROR, b"\npausing after this step; Ctrl-C again stops now\n")

    def safe_point(self) -> None:
        """Rest here if a pause was asked for; raises PRO-004 when the operator ends the procedure."""
        if not self._wanted:
            return
        # What was typed before answers nothing; what is typed as soon as the question stands there does.
        with contextlib.suppress(OSError, ValueError, termios.error):
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        tell("Paused; the arm is at rest. Press Enter to continue, or type abort to end the procedure:")
        answer = sys.stdin.readline()
        self._wanted = False
        if not answer or answer.strip().lower() == "abort":
            raise OperatorAborted("the operator ended the procedure while it was paused")


@contextlib.contextmanager
def pause_on_interrupt() -> Iterator[Pause]:
    """Let Ctrl-C ask for a pause while the block runs, where a person sits at a terminal."""
    pause = Pause()
    if not (on_terminal(sys.stdin) and on_terminal(sys.stderr)):
        yield pause
        return

    def asked(_number: int, _frame: FrameType | None) -> None:
        pause.ask()

    before = signal.signal(signal.SIGINT, asked)
    try:
        yield pause
    finally:
        signal.signal(signal.SIGINT, before)
