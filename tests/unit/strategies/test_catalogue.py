"""Strategies are found by name."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation
from strategy_arms import ARM

from procedures.strategies.catalogue import STRATEGIES, find_strategy
from procedures.strategies.errors import UNKNOWN_STRATEGY
from procedures.strategies.names import STRATEGY_NAMES
from procedures.strategies.strategy import arrival_signs, rest_sides
from procedures.strategies.trajectory import back_along_axis
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.frames import Frame, RigidTransform, Transform
from studies.accuracy.postures import TOOL


def test_the_commands_name_every_strategy() -> None:
    assert [strategy.name for strategy in STRATEGIES] == list(STRATEGY_NAMES)


@pytest.mark.parametrize(
    ("name", "per_trajectory", "approach"),
    [
        ("ocs", True, True),
        ("thesis-ocs", True, False),
        ("nos", False, False),
        ("jdms", True, True),
        ("improved", True, True),
        ("best", True, True),
        ("learning", False, True),
    ],
)
def test_a_strategy_declares_how_often_it_localizes_and_whether_it_controls_the_approach(
    name, per_trajectory, approach
):
    strategy = find_strategy(name)
    assert strategy.name == name
    assert strategy.localizes_per_trajectory is per_trajectory
    assert strategy.controls_approach is approach


def test_an_unknown_strategy_is_refused_and_named():
    with raises(UNKNOWN_STRATEGY, match=r"STR-002.*'fastest'") as caught:
        find_strategy("fastest")
    assert caught.value.exit_code == EXIT_USAGE


def test_the_arrival_direction_is_that_of_the_last_stretch_along_the_axis():
    at = (0.3, -1.2, 1.9, 0.4, 0.9, 2.8)
    pose = ARM.stereo_pose(at)
    before = np.array(ARM.guide_joints(back_along_axis(pose, 1.0)))
    signs = arrival_signs(ARM.kinematics, pose, at, ARM.flange_from_stereo)
    assert signs == tuple(np.where(np.array(at) >= before, 1, -1))


def leaning(x_mm: float, lean_deg: float) -> Transform:
    turn = Rotation.from_euler("y", 180.0 - lean_deg, degrees=True)
    return Transform(Frame.ROBOT, Frame.TOOL, RigidTransform.from_components([x_mm, 0.0, 200.0], turn))


def sides_at(pose: Transform) -> tuple[int, ...]:
    kinematics = kr6_r900()
    branch = kinematics.branch_of(kinematics.home_rad)
    at = kinematics.solve_branch(Pose.from_transform(pose @ TOOL.inverse()), branch, kinematics.home_rad)
    known = rest_sides(kinematics, pose, at, TOOL, 60.0)
    signs = arrival_signs(kinematics, pose, at, TOOL)
    assert all(side in (0, sign) for side, sign in zip(known, signs, strict=True))
    return known


@pytest.mark.parametrize("x_mm", [470.0, 490.0, 510.0])
def test_a_joint_that_reverses_near_the_end_of_the_line_rests_on_no_known_side(x_mm):
    assert sides_at(leaning(x_mm, -56.0 + (x_mm - 470.0) / 5.0))[1] == 0
    assert sides_at(leaning(x_mm, 10.0))[1] != 0


def test_a_joint_that_hardly_turns_on_the_line_rests_on_no_known_side():
    """The arm moves in the plane of its middle: A1, A4 and A6 stand still."""
    assert sides_at(leaning(600.0, 10.0)) == (0, 1, -1, 0, -1, 0)
    aside = Transform.of(Frame.ROBOT, Frame.ROBOT, translation_mm=(0.0, 150.0, 0.0))
    assert sides_at(aside @ leaning(600.0, 30.0))[0] != 0
