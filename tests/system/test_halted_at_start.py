"""Any process of a simulated case is halted as it starts: the case reports it and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from memory_folder import shared_memory
from user_commands import Commands, one_error
from waiting import eventually

CASE = ("run", "--sim", "--scene", "mini", "--seed", "7", "--json")
SIGHT_LIMIT_S = 60.0
ENDS_WITHIN_S = 60.0  # start-up limits of 10 s each, one after the other, on a machine under load
LOOK_S = 0.002


@pytest.fixture
def temporary(commands: Commands, tmp_path: Path) -> Path:
    """Where the commands keep what is temporary."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    commands.environment["TMPDIR"] = str(folder)
    return folder


@pytest.mark.slow
@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("sim.cli theatre", "ronna-sim theatre did not become ready"),
        ("sim.cli polaris", "ronna-sim polaris did not become ready"),
        ("sim.cli kuka", "ronna-sim kuka did not become ready"),
        ("sim.cli basler", "ronna-sim basler did not become ready"),
        ("kuka_rsi.realtime.process", "RSI-001"),
        ("receiver_process", ""),
    ],
)
def test_a_process_halted_at_its_start_ends_the_case_and_leaves_nothing_behind(
    commands: Commands, tmp_path: Path, temporary: Path, words: str, told: str
) -> None:
    shared = shared_memory()
    process = commands.start("ronna-procedure", *CASE, "--out", str(tmp_path / "runs"))
    os.kill(_first_sight(commands, words), signal.SIGSTOP)
    _, stderr = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode not in (0, 1), stderr
    assert told in " ".join(one_error(stderr))
    assert commands.await_no_survivors() == []
    assert list(temporary.iterdir()) == []
    eventually(lambda: shared_memory() <= shared)  # other programs have semaphores there for moments


def _first_sight(commands: Commands, words: str) -> int:
    deadline = time.monotonic() + SIGHT_LIMIT_S
    while time.monotonic() < deadline:
        for number in commands.survivors():
            try:
                said = Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue
            if words in said:
                return number
        time.sleep(LOOK_S)
    raise AssertionError(f"no process {words}")
