"""One process of a case stands still for three seconds (SIGSTOP), at moments from set-up to confirmation.

The case goes on as if nothing had happened, or ends with the error of what had stood still; then it is
resumed to its target. At its end the arm rests inside its ranges.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import time
from math import radians
from pathlib import Path
from typing import NamedTuple

import pytest
from kills import REACHED_S, Killed, reopen_run
from run_folders import records_of, run_folder
from user_commands import Commands
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from ronna_hw.evidence.inspection import inspect_run
from sim.world.descriptions import DESCRIPTIONS
from sim.world.world import World

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
STANDS_STILL_S = 3.0
ENDS_S = 300.0  # host time of a case, beside other work
LARGEST_ERROR_MM = 1.5
WORLD = re.compile(r"shm:///proc/\d+/fd/\d+")


class Stand(NamedTuple):
    """A process, by words of its command line, and the codes with which a case may end without it."""

    arm: str
    name: str
    words: str
    codes: str = ""


# While an arm's stream is silent, theatre time runs free: a guard may miss the head for longer (PRO-017).
STANDS = (
    Stand("kr6", "program", "ronna-procedure run"),
    Stand("kr6", "link", "realtime.process", "EKI-010|RSI-0.."),
    Stand("kr6", "theatre", "sim.cli theatre", "PRO-013"),
    Stand("kr6", "controller", "sim.cli kuka", "EKI-0..|RSI-0..|PRO-017"),
    Stand("kr6", "tracker", "sim.cli polaris", "NDI-0.."),
    Stand("kr6", "camera", "sim.cli basler", "GEV-0.."),
    Stand("ur5e", "link", "realtime.process", "URD-0.."),
    Stand("ur5e", "controller", "sim.cli ur", "URD-0..|PRO-017"),
)
MOMENTS = (  # kind of a line of the journal, and a word in it
    ("intent", "set_up"),
    ("intent", "global_localization"),
    ("motion", "go"),
    ("intent", "tool_check"),
    ("motion", "insert"),
    ("motion", "withdraw"),
)


class RunningCase:
    """A case, and the processes that belong to it."""

    def __init__(self, commands: Commands, arm: str, out: Path) -> None:
        self._commands, self._out = commands, out
        self.process = commands.start("ronna-procedure", *CASE, "--arm", arm, "--out", str(out))

    @property
    def folder(self) -> Path:
        folder = run_folder(self._out)
        assert folder is not None
        return folder

    def await_moment(self, entry: str, word: str) -> None:
        """Return as soon as the journal has such a line."""
        mark = f'"entry":"{entry}"'.encode()

        def is_reached() -> bool:
            folder = run_folder(self._out)
            journal = None if folder is None else folder / JOURNAL_FILE
            if journal is None or not journal.exists():
                return False
            lines = journal.read_bytes().split(b"\n")
            return any(mark in line and f'"{word}"'.encode() in line for line in lines)

        eventually(lambda: self.process.poll() is not None or is_reached(), REACHED_S)
        assert self.process.poll() is None, "the case ended before"

    def find(self, words: str) -> int | None:
        """The process whose command line has these words, the first of several."""
        found = [number for number in sorted(self._commands.survivors()) if words in _command_line(number)]
        return found[0] if found else None

    def open_world(self) -> World:
        """The true world of its theatre."""
        found = [WORLD.search(_command_line(number)) for number in self._commands.survivors()]
        return World.open(next(one[0] for one in found if one))


def _command_line(number: int) -> str:
    try:
        return Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def assert_rests_inside_ranges(world: World) -> None:
    """The arm rests inside its joint ranges, by the memory that the theatre shared."""
    arm = world.arm()
    assert arm.at_rest
    for joint, angle in zip(DESCRIPTIONS[world.scene.arm.variant].joints, arm.joints_rad, strict=True):
        assert radians(joint.lower_deg) <= angle <= radians(joint.upper_deg), joint.name


@pytest.mark.parametrize("moment", MOMENTS, ids=" ".join)
@pytest.mark.parametrize("stand", STANDS, ids=lambda stand: f"{stand.arm} {stand.name}")
def test_a_case_outlives_a_process_that_stands_still_or_says_which(
    commands: Commands, tmp_path: Path, stand: Stand, moment: tuple[str, str]
) -> None:
    case = RunningCase(commands, stand.arm, tmp_path / "runs")
    case.await_moment(*moment)
    eventually(lambda: case.find(stand.words) is not None, REACHED_S)  # a link begins with the first motion
    number = case.find(stand.words)
    assert number is not None
    world = case.open_world()
    os.kill(number, signal.SIGSTOP)
    time.sleep(STANDS_STILL_S)  # the disturbance itself: nothing is awaited
    if stand.name == "program" and world.has_arm():  # its link process has ended the motion
        assert world.arm().at_rest
    with contextlib.suppress(ProcessLookupError):  # the case may have ended, and it with the case
        os.kill(number, signal.SIGCONT)
    told, _ = case.process.communicate(timeout=ENDS_S)
    assert commands.await_no_survivors() == []
    outcome = json.loads(told)
    journal = tuple(read_journal(case.folder / JOURNAL_FILE))
    assert journal[-1]["entry"] == Entry.CLOSED
    assert inspect_run(case.folder).problems == ()
    assert_rests_inside_ranges(world)
    if outcome["outcome"] != "done":
        code = outcome["error"]["code"]
        assert stand.codes, f"ended with {code}"
        assert re.fullmatch(stand.codes, code), code
        outcome = reopen_run(commands, Killed(case.folder, journal, tuple(records_of(case.folder))))
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
