"""Hazard 29: somebody sets the computer's clock in the middle of a case."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from jumping_clock import JumpingClock
from run_folders import await_motion_in, run_folder
from user_commands import Commands

from procedures.engine.journal import JOURNAL_FILE, read_journal

CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
HOUR_S = 3600.0
YEAR_S = 365.25 * 24 * HOUR_S
MEAN_ERROR_MM = 0.18021067547021166  # of that seed: no number depends on the wall clock


@pytest.fixture
def commands() -> Iterator[Commands]:
    started = Commands()
    yield started
    started.end_all()


@pytest.mark.slow
@pytest.mark.hazard(29)
@pytest.mark.parametrize("jumps_s", [(HOUR_S, 0.0), (-HOUR_S, HOUR_S), (20 * YEAR_S, -20 * YEAR_S)])
def test_a_case_whose_clock_jumps_comes_to_the_same_numbers_and_says_that_it_jumped(
    commands: Commands, tmp_path: Path, jumps_s: tuple[float, float]
) -> None:
    clock = JumpingClock(commands, tmp_path / "clock")
    out = tmp_path / "runs"
    process = commands.start("ronna-procedure", *CASE, "--out", str(out))
    for step, jump_s in zip(("relocalization:T1", "positioning:T1"), jumps_s, strict=True):
        await_motion_in(out, step)
        clock.jump_to(jump_s)
    stdout, stderr = process.communicate(timeout=150)
    assert process.returncode == 0, stderr
    assert json.loads(stdout)["mean_application_error_mm"] == MEAN_ERROR_MM
    folder = run_folder(out)
    assert folder is not None
    found = [line for line in read_journal(folder / JOURNAL_FILE) if "clock was set by" in json.dumps(line)]
    assert len(found) == len(jumps_s)
    assert commands.run("ronna-procedure", "verify", str(folder)).returncode == 0
