"""Ctrl-C on a terminal: once pauses at the next safe point, twice stops the arm, three times ends all.

Safe points are between steps and before each motion. While a question is open, the second one ends
everything. Without a terminal nothing is changed: one signal ends the command.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import TYPE_CHECKING

from procedures.cli.case.asking import WritePrompt, write_prompt
from ronna_hw.command_line.terminal import on_terminal

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

STANDARD_ERROR = 2
PAUSING = b"\npausing at the next safe point; Ctrl-C again stops the arm now\n"
STOPPING = b"\nstopping the arm; Ctrl-C again ends the command\n"
AT_QUESTION = b"\nthe arm rests; Ctrl-C again ends the command\n"


class Interrupts:
    """What Ctrl-C asks of an engine."""

    def __init__(self) -> None:
        self._engine: Engine | None = None
        self._count = 0
        self._at_question: int | None = None  # how often since a question stands
        self._prompt = ""

    def attach(self, engine: Engine) -> None:
        """From now on Ctrl-C is about this engine; before, it ends the command."""
        self._engine = engine

    @contextlib.contextmanager
    def asking(self) -> Iterator[WritePrompt]:
        """While a question is open, nothing moves: Ctrl-C twice ends the command, once shows the prompt
        again.

        A terminal throws away what it has not yet shown when Ctrl-C is typed.
        """
        self._at_question, self._prompt = 0, ""
        try:
            yield self._write
        finally:
            self._at_question = None

    def _write(self, prompt: str) -> None:
        self._prompt = prompt
        write_prompt(prompt)

    def interrupt(self) -> None:
        """One Ctrl-C more; raises KeyboardInterrupt when it is to end the command."""
        engine = self._engine
        if engine is None or self._at_question:
            raise KeyboardInterrupt
        if self._at_question is not None:
            self._at_question += 1
            os.write(STANDARD_ERROR, AT_QUESTION + self._prompt.encode())
            return
        self._count = self._count + 1 if engine.checkpoint.wanted else 1
        if self._count > 2:
            raise KeyboardInterrupt
        engine.checkpoint.pause("Ctrl-C")
        if self._count == 2:
            threading.Thread(target=engine.setting.workcell.stop, name="stop now").start()
        # This runs inside a signal handler: the buffered streams may be in the middle of a write.
        os.write(STANDARD_ERROR, PAUSING if self._count == 1 else STOPPING)


@contextlib.contextmanager
def pause_on_interrupt() -> Iterator[Interrupts]:
    """Let Ctrl-C ask for a pause while the block runs, where a person sits at a terminal."""
    interrupts = Interrupts()
    if not (on_terminal(sys.stdin) and on_terminal(sys.stderr)):
        yield interrupts
        return

    def asked(_number: int, _frame: FrameType | None) -> None:
        interrupts.interrupt()

    before = signal.signal(signal.SIGINT, asked)
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, before)
