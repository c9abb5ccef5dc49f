"""Ctrl-C at random moments between the start of a case and its first motion: a pause or an end."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pseudo_terminal import CTRL_C, Terminal, heed_ctrl_c
from run_folders import REACHED_S, assert_nothing_half_written, run_folder
from user_commands import Commands
from waiting import HANG_LIMIT_S

from procedures.journal.journal import JOURNAL_FILE, read_journal
from ronna_hw.errors import EXIT_INTERRUPTED
from ronna_hw.evidence.journal_reading import Entry, Line

CASE = ("run", "--sim", "--scene", "mini", "--seed", "5")
LINES_BEFORE_MOTION = 28
START_S, STEP_S = (0.05, 3.0), (0.0, 0.4)  # of the moment, after the start or after a line of the journal
PARTS, MOMENTS = 20, 10
ENDS = (EXIT_INTERRUPTED, -signal.SIGINT)  # the second before Python runs: to a shell they are the same


def _journal(out: Path) -> list[Line]:
    folder = run_folder(out)
    file = folder / JOURNAL_FILE if folder else None
    return list(read_journal(file)) if file and file.exists() else []


def _await_moment(chosen: random.Random, out: Path, running: Callable[[], bool]) -> None:
    """Wait for a random line of the journal, or for none, and then for a random time."""
    line = chosen.choice((0, chosen.randint(1, LINES_BEFORE_MOTION)))
    deadline_s = time.monotonic() + REACHED_S
    while len(_journal(out)) < line and running():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    time.sleep(chosen.uniform(*(STEP_S if line else START_S)))


def _at_a_terminal(commands: Commands, chosen: random.Random, out: Path) -> list[Line]:
    """Type Ctrl-C; the journal when the case has paused or ended, after which it is ended."""
    terminal = Terminal(commands, *CASE, "--out", str(out))
    try:
        _await_moment(chosen, out, lambda: terminal.process.poll() is None)
        terminal.type(CTRL_C)
        lines = []
        if terminal.pauses():
            lines = _journal(out)
            assert lines[-1]["entry"] == Entry.RESTED
            terminal.type(CTRL_C)
            terminal.await_text("Ctrl-C again ends the command")
            terminal.type(CTRL_C)
        assert terminal.rest() in ENDS, terminal.text[-2000:]
        return lines or _journal(out)
    finally:
        terminal.close()


def _in_a_group(commands: Commands, chosen: random.Random, out: Path) -> list[Line]:
    """Signal the whole group of a command without a terminal; the journal when it has ended."""
    line = commands.line("ronna-procedure", *CASE, "--out", str(out))
    with subprocess.Popen(
        line,
        env=commands.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_ctrl_c,  # noqa: PLW1509 - no thread of the test runs yet
    ) as process:
        _await_moment(chosen, out, lambda: process.poll() is None)
        os.killpg(process.pid, signal.SIGINT)
        _, messages = process.communicate(timeout=HANG_LIMIT_S)
    assert process.returncode in ENDS, messages
    return _journal(out)


@pytest.mark.soak
@pytest.mark.hazard(30)
@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", range(PARTS))
def test_ctrl_c_before_the_first_motion_pauses_or_ends_the_case_and_fails_no_step(
    commands: Commands, tmp_path: Path, part: int
) -> None:
    chosen = random.Random(part)
    for number in range(MOMENTS):
        out = tmp_path / f"runs{number}"
        lines = (_at_a_terminal if number % 2 else _in_a_group)(commands, chosen, out)
        assert [line for line in lines if line["entry"] == Entry.FAILED] == []
        assert commands.await_no_survivors() == []
        assert_nothing_half_written(out)
