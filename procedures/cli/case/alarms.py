"""What a person at a question or prompt learns of the devices: an answer may rely on an arm that moves."""

from __future__ import annotations

import contextlib
import select
import sys
import termios
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks while nothing is typed
MEANS = "Whatever you answer, no motion and no step begins before the fault is acknowledged by name."


class Alarms:
    """The devices in fault, as they were last seen: asks none of them anything."""

    def __init__(self, means: str = MEANS) -> None:
        """`means` follows what is in fault."""
        self._means = means
        self._engine: Engine | None = None
        self._reported: set[str] = set()  # roles, at this question

    def attach(self, engine: Engine) -> None:
        """From now on the devices of this engine are looked at; before, none."""
        self._engine = engine

    def begin(self) -> None:
        """A question opens: what is in fault already is shown with it."""
        self._reported = set()

    def new(self) -> list[str]:
        """One line for each device in fault of which this question's reader does not know yet."""
        faults = self._faults()
        lines = [f"{what}. {self._means}" for role, what in faults.items() if role not in self._reported]
        self._reported = set(faults)  # one that comes again is shown again
        return lines

    @property
    def note(self) -> str:
        """For the prompt, such as ` (the arm is in fault)`; empty while no device is."""
        roles = " and ".join(f"the {role}" for role in sorted(self._reported))
        return f" ({roles} {'is' if len(self._reported) == 1 else 'are'} in fault)" if roles else ""

    def _faults(self) -> dict[str, str]:
        return {} if self._engine is None else self._engine.faults.in_short


def forget_typed() -> None:
    """What was typed at the terminal and not read yet is lost."""
    with contextlib.suppress(termios.error):  # the terminal is gone, and its end is read
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def awaited(alarms: Alarms, ends_s: float | None = None) -> tuple[bool, list[str]]:
    """Wait at a terminal for a line, the end of time or an alarm: whether there is a line, and what to tell.

    What was typed before an alarm is lost: it was typed without knowing of it.
    """
    while True:
        left_s = LOOK_AGAIN_S if ends_s is None else max(0.0, ends_s - time.monotonic())
        ready, _, _ = select.select([sys.stdin], [], [], min(left_s, LOOK_AGAIN_S))
        if news := alarms.new():
            forget_typed()
            sys.stderr.write("\n")  # the prompt is still there
        if ready or news or (ends_s is not None and time.monotonic() >= ends_s):
            return bool(ready), news
