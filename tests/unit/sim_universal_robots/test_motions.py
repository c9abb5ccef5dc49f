"""Motions of programs, and what the drives make of set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import dist, pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ronna_hw.wire.universal_robots import RuntimeState, SafetyMode
from sim.universal_robots.controller import Controller
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.drives import Drives
from sim.universal_robots.kinematics import LinkPose, frame_of_pose, pose_of_frame
from sim.universal_robots.model import FULL_SPEED_RAD_S, HOME_RAD, LARGEST_ACCELERATION_RAD_S2
from sim.universal_robots.programs.arc import movec
from sim.universal_robots.programs.motions import movej, movel, speedj
from sim.universal_robots.programs.program import UrProgram
from sim.universal_robots.robot import Robot

CYCLE_S = 0.002
ROUNDING = 1e-9


def run(controller: Controller, motion: Callable[[Robot], Iterator[None]]) -> int:
    """Run a motion as a program and return its cycles."""
    assert not controller.start(UrProgram("motion", lambda robot, _: motion(robot)))
    for number in range(10_000):
        if controller.runtime_state is RuntimeState.STOPPED:
            return number
        controller.step()
    raise AssertionError("it does not end")


def test_a_joint_motion_ends_exactly_at_its_goal_in_the_time_of_its_profile(controller: Controller) -> None:
    goal = [HOME_RAD[0] + 0.5, *HOME_RAD[1:]]
    cycles = run(controller, lambda robot: movej(robot, goal, 1.0, 5.0))
    assert controller.robot.drives.target == goal
    assert cycles * CYCLE_S == pytest.approx(0.5 / 1.0 + 1.0 / 5.0, abs=3 * CYCLE_S)


def test_the_speed_slider_slows_a_motion(controller: Controller) -> None:
    controller.robot.set_speed_fraction(0.5)
    goal = [HOME_RAD[0] + 0.5, *HOME_RAD[1:]]
    cycles = run(controller, lambda robot: movej(robot, goal, 1.0, 5.0))
    assert cycles * CYCLE_S == pytest.approx(2.0 * 0.7, abs=3 * CYCLE_S)


def test_a_line_is_straight_and_ends_at_its_pose(controller: Controller) -> None:
    robot = controller.robot
    start = robot.tool_frame(robot.drives.target)
    goal = pose_of_frame(start._replace(y=start.y + 0.05, z=start.z + 0.05))
    frames: list[LinkPose] = []
    controller.start(UrProgram("line", lambda robot, _: movel(robot, goal, 0.5, 5.0)))
    while controller.runtime_state is not RuntimeState.STOPPED:
        controller.step()
        frames.append(robot.tool_frame(robot.drives.target))
    assert list(frames[-1]) == pytest.approx(list(frame_of_pose(goal)), abs=ROUNDING)
    assert all(abs((frame.y - start.y) - (frame.z - start.z)) < ROUNDING for frame in frames)
    assert all(dist(frame[:9], start[:9]) < ROUNDING for frame in frames)


def test_a_line_out_of_reach_ends_in_a_protective_stop(controller: Controller) -> None:
    far = [1.5, 0.0, 0.5, 0.0, pi, 0.0]
    controller.start(UrProgram("line", lambda robot, _: movel(robot, far, 0.5, 5.0)))
    for _ in range(1000):
        controller.step()
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP


@pytest.mark.parametrize(("waits", "mode"), [(True, SafetyMode.NORMAL), (False, SafetyMode.PROTECTIVE_STOP)])
def test_a_line_that_is_too_fast_for_the_joints_is_slowed_if_it_waits_for_them(
    controller: Controller, mode: SafetyMode, *, waits: bool
) -> None:
    robot = controller.robot
    start = robot.tool_frame(robot.drives.target)
    goal = pose_of_frame(start._replace(y=start.y + 0.2))
    controller.start(
        UrProgram("line", lambda robot, _: movel(robot, goal, 20.0, 40.0, waits_for_joints=waits))
    )
    while controller.runtime_state is RuntimeState.PLAYING:
        controller.step()
        assert max(map(abs, robot.drives.target_speed)) <= FULL_SPEED_RAD_S * (1.0 + ROUNDING)
    assert controller.modes.safety_mode is mode
    assert (dist(robot.tool_pose(robot.drives.target)[:3], goal[:3]) < 1e-4) is waits


@pytest.mark.parametrize("keeps_turn", [True, False])
def test_an_arc_passes_through_its_second_pose(controller: Controller, *, keeps_turn: bool) -> None:
    robot = controller.robot
    x, y, z, *turn = robot.tool_pose(robot.drives.target)
    via, goal = [x, y + 0.05, z + 0.05, *turn], [x, y + 0.1, z, *turn]
    passed: list[list[float]] = []
    program = UrProgram("arc", lambda robot, _: movec(robot, via, goal, 0.2, 2.0, keeps_turn=keeps_turn))
    controller.start(program)
    while controller.runtime_state is not RuntimeState.STOPPED:
        controller.step()
        passed.append(robot.tool_pose(robot.drives.target))
    centre = (x, y + 0.05, z)
    assert all(dist(pose[:3], centre) == pytest.approx(0.05, abs=1e-6) for pose in passed)
    assert min(dist(pose[:3], via[:3]) for pose in passed) < 0.2 * CYCLE_S
    assert passed[-1][:3] == pytest.approx(goal[:3], abs=1e-6)
    keeps_orientation = passed[-1] == pytest.approx(goal, abs=1e-6)
    assert keeps_orientation is not keeps_turn


def test_an_ended_program_leaves_a_braking_arm(controller: Controller) -> None:
    def once(robot: Robot) -> Iterator[None]:
        for _ in range(200):
            speedj(robot, [0.5] * 6, 5.0)
            yield

    run(controller, once)
    assert not controller.robot.drives.moving


@settings(max_examples=15, deadline=None)
@given(st.lists(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), min_size=1, max_size=3))
def test_whatever_it_is_told_the_servo_keeps_speed_and_acceleration_and_arrives(
    goals: list[list[float]],
) -> None:
    drives = Drives([0.0] * 6, CYCLE_S, ControllerParameters())
    speed = [0.0] * 6
    for goal in (*goals, goals[-1]):
        for _ in range(200 if goal is not goals[-1] else 1500):
            drives.servo(goal, 0.034)
            changes = [abs(a - b) for a, b in zip(drives.target_speed, speed, strict=True)]
            speed = drives.target_speed
            assert max(changes) <= LARGEST_ACCELERATION_RAD_S2 * CYCLE_S * (1 + ROUNDING)
            assert max(map(abs, speed)) <= FULL_SPEED_RAD_S * (1 + ROUNDING)
    assert drives.target == goals[-1]
    assert drives.at_rest
    assert not drives.trip
