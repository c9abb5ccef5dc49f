"""Hazard 29: the computer's clock is set in the middle of a case."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from jumping_clock import JumpingClock
from run_folders import await_motion_in, run_folder
from undisturbed import MINI_SEED_3, undisturbed_mini
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, read_journal

HOUR_S = 3600.0
YEAR_S = 365.25 * 24 * HOUR_S


@pytest.fixture
def commands() -> Iterator[Commands]:
    started = Commands()
    yield started
    started.end_all()


@pytest.mark.slow
@pytest.mark.hazard(29)
@pytest.mark.parametrize("jumps_s", [(HOUR_S, 0.0), (-HOUR_S, HOUR_S), (20 * YEAR_S, -20 * YEAR_S)])
def test_clock_jumps_leave_the_results_of_a_case_unchanged_and_are_reported(
    commands: Commands, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, jumps_s: tuple[float, float]
) -> None:
    undisturbed = undisturbed_mini(tmp_path_factory)
    clock = JumpingClock(commands, tmp_path / "clock")
    out = tmp_path / "runs"
    process = commands.start("ronna-procedure", *MINI_SEED_3, "--out", str(out))
    for step, jump_s in zip(("relocalization:T1", "positioning:T1"), jumps_s, strict=True):
        await_motion_in(out, step)
        clock.jump_to(jump_s)
    stdout, stderr = process.communicate(timeout=150)
    assert process.returncode == 0, stderr
    assert json.loads(stdout)["targets"] == undisturbed["targets"]
    folder = run_folder(out)
    assert folder is not None
    found = [
        line for line in read_journal(folder / JOURNAL_FILE) if "clock was changed by" in json.dumps(line)
    ]
    assert len(found) == len(jumps_s)
    assert commands.run("ronna-procedure", "verify", str(folder)).returncode == 0
