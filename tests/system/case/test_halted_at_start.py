"""Any process is halted as it starts: the command reports it and leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import gdcm
import numpy as np
import pytest
from memory_folder import shared_memory
from painted_ct import compress_slice, write_series
from user_commands import Commands, one_error
from waiting import eventually

from ronna_hw.errors import EXIT_FAILED

CASE = ("run", "--sim", "--scene", "mini", "--seed", "7", "--json")
SIGHT_LIMIT_S = 60.0
ENDS_WITHIN_S = 60.0  # start-up limits of 10 s each, one after the other, on a machine under load
CASE_S = 90.0
LOOK_S = 0.002


@pytest.fixture
def temporary(commands: Commands, tmp_path: Path) -> Path:
    """Where the commands keep what is temporary."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    commands.environment["TMPDIR"] = str(folder)
    return folder


@pytest.fixture
def nothing_left(commands: Commands, temporary: Path) -> Callable[[], None]:
    """To be called at the end: no process, temporary file or shared memory remains."""
    shared = shared_memory()

    def check() -> None:
        assert commands.await_no_survivors() == []
        assert list(temporary.iterdir()) == []
        eventually(lambda: shared_memory() <= shared)  # other programs have semaphores there for moments

    return check


@pytest.mark.slow
@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("sim.cli theatre", "ronna-sim theatre did not become ready"),
        ("sim.cli polaris", "ronna-sim polaris did not become ready"),
        ("sim.cli kuka", "ronna-sim kuka did not become ready"),
        ("sim.cli basler", "ronna-sim basler did not become ready"),
        ("sim.cli phantom", "ronna-sim phantom did not finish"),
        ("sim.cli verify", "ronna-sim verify did not finish"),
        ("kuka_rsi.realtime.process", "RSI-001"),
        ("receiver_process", ""),
    ],
)
def test_a_process_halted_at_its_start_ends_the_case_and_leaves_nothing_behind(
    commands: Commands, tmp_path: Path, nothing_left: Callable[[], None], words: str, shown: str
) -> None:
    process = commands.start("ronna-procedure", *CASE, "--out", str(tmp_path / "runs"))
    os.kill(_first_sight(commands, words), signal.SIGSTOP)
    _, stderr = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode not in (0, 1), stderr
    assert shown in " ".join(one_error(stderr))
    nothing_left()


@pytest.mark.slow
@pytest.mark.hazard(4)
def test_a_case_completes_without_a_console_halted_at_its_start(
    commands: Commands, tmp_path: Path, nothing_left: Callable[[], None]
) -> None:
    process = commands.start("ronna-procedure", *CASE, "--console", "--out", str(tmp_path / "runs"))
    os.kill(_first_sight(commands, "console.serving"), signal.SIGSTOP)
    stdout, stderr = process.communicate(timeout=ENDS_WITHIN_S + CASE_S)
    assert process.returncode == 0, stderr
    assert json.loads(stdout)["outcome"] == "done"
    assert "no console: PRC-001" in stderr
    nothing_left()


@pytest.mark.slow
@pytest.mark.hazard(4)
def test_a_slice_decoder_halted_at_its_start_ends_the_reading_of_the_series_and_leaves_nothing_behind(
    commands: Commands, tmp_path: Path, nothing_left: Callable[[], None]
) -> None:
    series = write_series(tmp_path / "ct", np.zeros((3, 8, 8), np.int16))
    for path in series.iterdir():
        compress_slice(path, gdcm.TransferSyntax.JPEG2000Lossless)
    process = commands.start("ronna-ct", "localize", str(series))
    os.kill(_first_sight(commands, "decoder_process"), signal.SIGSTOP)
    _, stderr = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode == EXIT_FAILED, stderr
    assert "CT-005" in " ".join(one_error(stderr))
    nothing_left()


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
