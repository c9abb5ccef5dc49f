"""`ronna-arm guide`: an arm follows a hand while the space bar is held."""

from __future__ import annotations

import os
import select
import shlex
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from procedures.engine.errors import RECOVERY_REFUSED
from procedures.runs.reopening import resumable_run
from procedures.runs.theatre_lock import hold_theatre, require_free_theatre
from procedures.workcell.assistant import holder_bodies
from procedures.workcell.hand_guiding import lead_by_hand
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import on_terminal, say, tell
from ronna_hw.devices.contact import HandGuidance
from ronna_hw.theatre import Theatre

HELD_S = 0.7  # host time: a key that is held repeats after half a second, then thirty times a second
SWITCH, END = b" ", b"q"
LOOK_S = 0.02  # host time, longest wait for a key


class HeldKey:
    """Key of a terminal as a switch: held while it repeats."""

    def __init__(self, descriptor: int, now_s: Callable[[], float] = time.monotonic) -> None:
        """Read the keys from a terminal that hands over each one at once."""
        self._descriptor, self._now_s = descriptor, now_s
        self._pressed_s = -HELD_S
        self.is_over = False

    def is_held(self) -> bool:
        """Whether the key is held; waits a moment for it."""
        if select.select([self._descriptor], [], [], LOOK_S)[0]:
            keys = os.read(self._descriptor, 64)
            self.is_over = self.is_over or not keys or END in keys
            if SWITCH in keys:
                self._pressed_s = self._now_s()
        return not self.is_over and self._now_s() - self._pressed_s < HELD_S


def guide(config: Path, name: str, guidance: HandGuidance) -> None:
    """Let an arm of a theatre follow a hand. Raises CLI-001 without a terminal.

    PRO-032 for a run that is unfinished, PRO-043 and PRO-047 as a new run, DEV-007 without that arm, ARM-012
    to ARM-015 and the driver's errors.
    """
    if not on_terminal(sys.stdin):
        raise UsageMistake(
            "guide needs a terminal, whose space bar is the switch that a person holds",
            expected="a terminal on standard input",
            got="a file, a pipe or nothing",
            action="Run it at a terminal, without a pipe.",
        )
    require_free_theatre(config, (name,))
    if (run := resumable_run(config)) is not None:
        raise RECOVERY_REFUSED(
            f"run {run.name} on this theatre is unfinished, and knows its arms where it left them",
            action=f"Nothing was moved. Bring them home first: ronna-procedure home {shlex.quote(str(run))}.",
        )
    with Theatre.from_file(config) as theatre, hold_theatre(config, None, (name,)):
        theatre.require(f"robot.{name}")
        holders = {} if theatre.file.calibration is None else theatre.file.calibration.holders
        around = Surroundings(tool=holder_bodies(holders[name]) if name in holders else ())
        tell(
            f"{name}: hold the space bar and push the tool; q ends. At most {guidance.speed_mm_s:g} mm/s, "
            f"{guidance.reach_mm:g} mm from where each push began, {guidance.force_limit_N:g} N. Starting "
            "may move the joints a little. Other arms are not watched: keep clear of them"
        )
        with _each_key_at_once() as key:
            last = lead_by_hand(theatre.arms[name], guidance, around, key.is_held, lambda: key.is_over)
    say("the arm rests" if last is None else f"the arm rests; the last guidance: {last.end}")


@contextmanager
def _each_key_at_once() -> Iterator[HeldKey]:
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield HeldKey(sys.stdin.fileno())
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
