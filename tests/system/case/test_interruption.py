"""Whatever ends the command early: the arm stops, the run is closed, nothing is left behind."""

import os
import signal
import time
from pathlib import Path

import pytest
from run_folders import assert_nothing_half_written, await_motion_in
from user_commands import Commands, one_error

from ronna_hw.errors import EXIT_LINK_LOST

CASE = ("run", "--sim", "--scene", "mini", "--seed", "5")
MOVING_STEP = "relocalization:T1"
WITHOUT_PROCESSOR_S = 8.0  # a program of idle priority, on two cores with a load of eight


def _process_of(commands: Commands, words: str) -> int:
    for number in commands.survivors():
        try:
            if words in Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode():
                return number
        except OSError:
            continue
    raise AssertionError(f"no process {words}")


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("words", "number"),
    [
        ("sim.cli basler", signal.SIGKILL),
        pytest.param("sim.cli theatre", signal.SIGKILL, marks=pytest.mark.slow),
        *(
            pytest.param(words, signal.SIGSTOP, marks=pytest.mark.slow)
            for words in ("sim.cli kuka", "sim.cli theatre", "sim.cli polaris", "receiver_process")
        ),
    ],
)
def test_a_device_that_dies_during_a_motion_is_reported_and_everything_ends(
    commands: Commands, tmp_path: Path, words: str, number: signal.Signals
) -> None:
    out = tmp_path / "runs"
    process = commands.start("ronna-procedure", *CASE, "--out", str(out))
    await_motion_in(out, MOVING_STEP)
    os.kill(_process_of(commands, words), number)
    _, stderr = process.communicate(timeout=150)
    assert process.returncode == EXIT_LINK_LOST, stderr
    one_error(stderr)
    assert commands.await_no_survivors() == []
    assert_nothing_half_written(out)


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_case_that_got_no_processor_for_seconds_goes_on_in_lock_step(
    commands: Commands, tmp_path: Path
) -> None:
    out = tmp_path / "runs"
    process = commands.start("ronna-procedure", *CASE, "--out", str(out))
    await_motion_in(out, MOVING_STEP)
    process.send_signal(signal.SIGSTOP)
    time.sleep(WITHOUT_PROCESSOR_S)  # the duration itself is what it must bear
    process.send_signal(signal.SIGCONT)
    _, stderr = process.communicate(timeout=150)
    assert process.returncode == 0, stderr
