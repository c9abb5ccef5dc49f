"""One process of a case stands still for three seconds (SIGSTOP): once in every step, and amid motions.

The case goes on as if nothing had happened, or ends with the error of what had stood still; then it is
resumed to its target. At its end the arm rests inside its ranges.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import time
from pathlib import Path
from typing import NamedTuple

import pytest
from disturbed_steps import disturb_every_step
from kills import Killed, reopen_run
from run_folders import records_of
from running_case import RunningCase
from single_faults import DONE
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]

MINI = ("--scene", "mini", "--seed", "3")
ARMS = {
    "kr6": (),
    "ur5e": ("--arm", "ur5e"),
    "two kr6": ("--dual",),
    "kr6 and ur5e": ("--dual", "--assistant-arm", "ur5e"),
}
STANDS_STILL_S = 3.0
LARGEST_ERROR_MM = 1.5


class Stand(NamedTuple):
    """A process, by words of its command line, and the codes with which a case may end without it."""

    arms: str
    name: str
    words: str
    codes: str = ""


# While an arm's stream is silent, theatre time runs free: a guard may miss the head for longer (PRO-017).
STANDS = [
    Stand("kr6", "program", "ronna-procedure r"),  # run, and resume
    Stand("kr6", "link", "realtime.process", "EKI-010|RSI-0.."),
    Stand("kr6", "theatre", "sim.cli theatre", "PRO-013"),
    Stand("kr6", "controller", "sim.cli kuka", "EKI-0..|RSI-0..|PRO-017"),
    Stand("kr6", "tracker", "sim.cli polaris", "NDI-0.."),
    Stand("kr6", "camera", "sim.cli basler", "GEV-0.."),
    Stand("ur5e", "link", "realtime.process", "URD-0.."),
    Stand("ur5e", "controller", "sim.cli ur", "URD-0..|PRO-017"),
]
ASSISTANTS = [
    Stand(
        "two kr6", "controller of the assistant", "--role assistant", "DUAL-00[13]|EKI-0..|RSI-0..|PRO-017"
    ),
    Stand("kr6 and ur5e", "controller of the assistant", "--role assistant", "DUAL-00[13]|URD-0..|PRO-017"),
    Stand(
        "kr6 and ur5e", "link of the assistant", "universal_robots.realtime", "DUAL-00[13]|URD-0..|PRO-017"
    ),
]
MOTIONS = ("go", "insert", "withdraw")


def begin(commands: Commands, stand: Stand, folder: Path) -> RunningCase:
    return RunningCase(commands, (*MINI, *ARMS[stand.arms]), folder / "runs")


def halt(case: RunningCase, stand: Stand) -> bool:
    """Let its process stand still, if it is there; without the program the arm comes to rest."""
    number = case.find(stand.words)
    if number is None:
        return False
    world = case.world
    with contextlib.suppress(ProcessLookupError):  # the case may have ended, and it with the case
        os.kill(number, signal.SIGSTOP)
        time.sleep(STANDS_STILL_S)  # the disturbance itself: nothing is awaited
        if stand.name == "program" and world.has_arm():  # its link process has ended the motion
            assert world.arm().at_rest
        os.kill(number, signal.SIGCONT)
    return True


@pytest.mark.parametrize("stand", [*STANDS, *ASSISTANTS], ids=lambda stand: f"{stand.arms} {stand.name}")
def test_a_case_outlives_a_process_that_stands_still_in_every_step_or_says_which(
    commands: Commands, tmp_path: Path, stand: Stand
) -> None:
    case = begin(commands, stand, tmp_path)
    outcome = disturb_every_step(case, lambda case: halt(case, stand), stand.codes)
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("stand", STANDS, ids=lambda stand: f"{stand.arms} {stand.name}")
def test_a_case_outlives_a_process_that_stands_still_amid_a_motion_or_says_which(
    commands: Commands, tmp_path: Path, stand: Stand, motion: str
) -> None:
    case = begin(commands, stand, tmp_path)
    case.await_line(lambda line: line["entry"] == Entry.MOTION and line["what"] == motion)
    stood_still: list[bool] = []
    case.eventually(lambda: halt(case, stand) and not stood_still.append(True))
    assert stood_still, f"no process {stand.words!r} was found"
    outcome = case.end()
    if outcome["outcome"] != DONE:
        assert any(re.fullmatch(stand.codes, one) for one in case.codes), case.codes
        journal = tuple(read_journal(case.folder / JOURNAL_FILE))
        outcome = reopen_run(commands, Killed(case.folder, journal, tuple(records_of(case.folder))))
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
