"""`open_theatre` and `simulated_theatre`, as README and how-to show them, and how they handle errors."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from undisturbed import finished_mini
from waiting import eventually

from ronna_hw import open_theatre, simulated_theatre
from ronna_hw.clock import ClockUnavailable
from ronna_hw.control_port import ControlAddress
from ronna_hw.devices import RobotArm
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildNotReady, descendants_of
from ronna_hw.theatre import TheatreProcess

ROOT = Path(__file__).parents[3]
SIMULATORS = 4  # robot, tracker, cameras, and what draws the pictures of the second camera
TURN_RAD = 0.5
SLOWLY = 0.001  # of the working speed: no test waits for the end of such a motion
CLOSED_WITHIN_S = 15.0

MOVES_UNTIL_INTERRUPTED = f"""
import signal

from ronna_hw import open_theatre
from ronna_hw.devices.robot import JointMove

signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell ignores in what it starts with &
with open_theatre("theatre.toml") as theatre, theatre.arms["master"].active() as arm:
    A1, A2, A3, A4, A5, A6 = arm.read_state().joints_rad
    print("moving", flush=True)
    arm.move(JointMove((A1 + {TURN_RAD}, A2, A3, A4, A5, A6), speed_fraction={SLOWLY}), timeout_s=1e6)
"""


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TheatreProcess]:
    """One simulated theatre for the whole module, with nobody connected to it."""
    process = TheatreProcess("--scene", "mini", "--seed", "7", "--out", str(tmp_path_factory.mktemp("t")))
    try:
        process.await_ready()
        yield process
    finally:
        process.end()


@pytest.fixture
def theatre_file(process: TheatreProcess) -> Path:
    return process.file


def test_the_simulators_of_a_theatre_are_not_told_its_control_token(process: TheatreProcess) -> None:
    token = ControlAddress.parse(process.control).token.encode()
    simulators = descendants_of(process.child.process.pid)
    assert len(simulators) == SIMULATORS
    for simulator in simulators:
        for shown in ("cmdline", "environ"):
            assert token not in Path(f"/proc/{simulator.pid}/{shown}").read_bytes()


def start_to_move(arm: RobotArm) -> tuple[threading.Thread, list[RonnaError]]:
    """Begin a long motion in another thread; returns when the arm moves."""

    def move() -> None:
        try:
            A1, A2, A3, A4, A5, A6 = arm.read_state().joints_rad
            target_rad = (A1 + TURN_RAD, A2, A3, A4, A5, A6)
            arm.move(JointMove(target_rad, speed_fraction=SLOWLY), timeout_s=1e6)
        except RonnaError as error:
            ended.append(error)

    ended: list[RonnaError] = []
    thread = threading.Thread(target=move)
    thread.start()
    eventually(lambda: arm.read_state().moving)
    return thread, ended


def assert_at_rest(theatre_file: Path) -> None:
    """The controller takes a new session, in which the arm stands still."""
    with open_theatre(theatre_file) as theatre:
        arm = theatre.arms["master"]
        first, second = arm.read_state(), arm.read_state()
        assert not first.moving
        assert first.joints_rad == second.joints_rad


def run_python_of(page: Path) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(block, page.name, "exec"), {})


def test_the_python_of_the_readme_runs(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "runs").symlink_to(finished_mini(tmp_path_factory)[0])
    monkeypatch.chdir(tmp_path)
    run_python_of(ROOT / "README.md")
    targets, *spheres = capsys.readouterr().out.splitlines()
    assert targets.startswith("['T1'] [0.")
    assert len(spheres) == 3


def test_the_python_of_a_theatre_of_your_own_runs(
    theatre_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(theatre_file.parent)
    run_python_of(ROOT / "docs/how-to/devices/a-theatre-of-your-own.md")


def test_an_error_in_the_block_while_the_arm_moves_leaves_the_arm_at_rest(theatre_file: Path) -> None:
    def break_off() -> None:
        with open_theatre(theatre_file) as theatre:
            arm = theatre.arms["master"]
            arm.activate()
            motions.append((*start_to_move(arm), time.monotonic()))
            raise ZeroDivisionError

    motions: list[tuple[threading.Thread, list[RonnaError], float]] = []
    with pytest.raises(ZeroDivisionError):
        break_off()
    thread, ended, raised_s = motions[0]
    thread.join(CLOSED_WITHIN_S)
    assert time.monotonic() - raised_s < CLOSED_WITHIN_S
    assert [error.code for error in ended] == ["RSI-010"]
    assert_at_rest(theatre_file)


def test_two_interrupts_while_the_arm_moves_leave_it_at_rest(theatre_file: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-P", "-c", MOVES_UNTIL_INTERRUPTED],
        cwd=theatre_file.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "moving\n"
        for _ in range(2):
            program.send_signal(signal.SIGINT)
        _, said = program.communicate(timeout=CLOSED_WITHIN_S)
    assert said.rstrip().endswith("KeyboardInterrupt"), said
    assert_at_rest(theatre_file)


def test_the_file_of_an_ended_theatre_is_refused_before_any_device_is_opened(
    theatre_file: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "theatre.toml"
    kept.write_text(re.sub(r"shm://[^\"]*", f"shm://{tmp_path}/gone", theatre_file.read_text()))
    with pytest.raises(ClockUnavailable, match="CLK-001"), open_theatre(kept):
        pass


def test_a_missing_scene_is_reported_in_the_words_of_the_command() -> None:
    with pytest.raises(ChildNotReady, match="SIM-001"), simulated_theatre("moon"):
        pass
