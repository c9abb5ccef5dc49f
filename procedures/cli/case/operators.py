"""Who answers the procedure's questions: a person at the terminal, or the script of a simulated case."""

from __future__ import annotations

import sys
import termios
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from procedures.engine.operator import Question
from ronna_hw.host.control_port import ControlPortClient


class ScriptedOperator:
    """Says yes to every question; what was shown is in the journal."""

    def confirm(self, question: Question) -> bool:
        """Say yes."""
        return bool(question.subject)


class SimulatedRoom:
    """The hands in a simulated theatre, and the only one who talks to its control port."""

    def __init__(self, control: str) -> None:
        """Raises CTL-001 when no theatre answers there."""
        self._theatre = ControlPortClient(control)

    def announce(self, step: str) -> None:
        """Tell the theatre which step is running."""
        self._theatre.ask("step", name=step)

    def change_tool(self, number: int, description: str) -> None:
        """Hang the other tool on the mount."""
        self._theatre.ask("mount", number=number)

    def close(self) -> None:
        """Leave the room."""
        self._theatre.close()


class TerminalOperator:
    """A person at the terminal. Without a terminal every answer is no.

    `asking` is held while a question stands, so that nothing else writes over it.
    """

    def __init__(self, asking: Callable[[], AbstractContextManager[None]] = nullcontext) -> None:
        self._asking = asking

    def confirm(self, question: Question) -> bool:
        """Show the value and wait for a typed `yes`; anything else, or no answer in time, is no."""
        if not sys.stdin.isatty():
            return False
        with self._asking():
            # What was typed before the question was seen answers nothing.
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
            sys.stderr.write(f"{question.subject}\n  {question.value}\nType yes to confirm: ")
            sys.stderr.flush()
            return _line_within(question.timeout_s).strip().lower() == "yes"


class TerminalRoom:
    """The hands of whoever sits at the terminal."""

    def __init__(self, asking: Callable[[], AbstractContextManager[None]] = nullcontext) -> None:
        self._asking = asking

    def announce(self, step: str) -> None:
        """Nothing to do: the person sees the progress."""

    def change_tool(self, number: int, description: str) -> None:
        """Say what to mount; that it is done is confirmed, and recorded, by the step."""
        with self._asking():
            sys.stderr.write(f"Mount {description} (tool {number}).\n")
            sys.stderr.flush()


def _line_within(timeout_s: float) -> str:
    import select

    ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
    return sys.stdin.readline() if ready else ""
