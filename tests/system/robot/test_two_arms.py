"""Two simulated arms in one theatre, over their links: motions in turn and together, and a halt of both."""

from __future__ import annotations

from collections.abc import Iterator
from math import radians
from pathlib import Path

import pytest

from procedures.workcell.arms import Arms
from procedures.workcell.errors import BothArmsHalted
from ronna_hw.arm.pose import Pose
from ronna_hw.control_port import ask_control_port
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove, RobotArm
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.theatre import SimulatedTheatre, TheatreProcess
from sim.world.scene.model import read_scene
from sim.world.truth import SCENE_FILE

pytestmark = pytest.mark.slow


@pytest.fixture
def theatre(tmp_path: Path) -> Iterator[SimulatedTheatre]:
    process = TheatreProcess("--scene", "mini", "--seed", "3", "--dual", "--out", str(tmp_path))
    try:
        process.await_ready()
        with SimulatedTheatre.of(process) as theatre:
            theatre.connect(20.0)
            yield theatre
    finally:
        process.end()


def paired(theatre: SimulatedTheatre, folder: Path) -> Arms:
    assistant = read_scene(folder / SCENE_FILE).assistant
    assert assistant is not None
    base, arms = assistant.robot_from_base, Arms(theatre.arms, (MASTER, ASSISTANT), theatre.clock)
    arms.place(ASSISTANT, Pose.from_quaternion(base.translation_mm, base.quaternion_wxyz))
    return arms


def turned(arm: RobotArm, base_deg: float) -> JointMove:
    first, *others = arm.read_state().joints_rad
    return JointMove((first + radians(base_deg), *others))


def swing(pair: Arms, master: RobotArm) -> None:
    for angle_deg in (30.0, -30.0, 30.0, -30.0):
        pair.move(MASTER, turned(master, angle_deg))


def test_two_arms_move_in_turn(theatre: SimulatedTheatre, tmp_path: Path) -> None:
    pair, arms = paired(theatre, tmp_path), theatre.arms
    with arms[MASTER].active(), arms[ASSISTANT].active():
        for role, angle_deg in ((MASTER, 20.0), (ASSISTANT, -20.0)):
            goal = turned(arms[role], angle_deg)
            assert pair.move(role, goal).joints_rad == pytest.approx(goal.target_rad, abs=1e-4)


def test_a_fault_of_the_assistant_halts_the_moving_master(theatre: SimulatedTheatre, tmp_path: Path) -> None:
    pair, arms = paired(theatre, tmp_path), theatre.arms
    with arms[MASTER].active(), arms[ASSISTANT].active():
        ask_control_port(theatre.control, "fault", line="assistant robot trip velocity")
        with pytest.raises(BothArmsHalted):
            swing(pair, arms[MASTER])
        assert {arm.state for arm in arms.values()} == {Lifecycle.FAULT}
        assert pair.halted is not None
        assert pair.halted.arm == ASSISTANT
