"""Six values describe a tool pose, and a turn about the guide's axis is one of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.strategies.pose_values import PoseValues
from procedures.strategies.trajectory import Trajectory, target_pose, tool_pose
from ronna_hw.frames import Frame, Transform

ROBOT_FROM_CT = tool_pose(Rotation.from_euler("zyx", (0.3, -0.2, 2.9)), np.array([600.0, -150.0, 300.0]))


def values(free_angle_rad: float) -> PoseValues:
    trajectory = Trajectory("T1", (-30.0, 20.0, 60.0), (10.0, 5.0, 0.0), free_angle_rad, beyond_mm=-150.0)
    robot_from_ct = Transform(Frame.ROBOT, Frame.CT, ROBOT_FROM_CT.rigid)
    return PoseValues.of(target_pose(trajectory, robot_from_ct))


def test_a_trajectory_fixes_five_values_and_its_free_angle_changes_gamma_alone() -> None:
    planned, turned = values(0.0), values(0.4)
    assert turned[:5] == pytest.approx(planned[:5])
    assert turned.gamma_rad - planned.gamma_rad == pytest.approx(0.4)


def test_the_pose_follows_from_its_six_values() -> None:
    for rotation in Rotation.random(50, random_state=3):
        pose = tool_pose(rotation, np.array([400.0, 20.0, -30.0]))
        assert np.allclose(PoseValues.of(pose).pose.as_matrix(), pose.as_matrix())


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_a_vertical_guide_has_its_turn_in_gamma(axis: tuple[float, float, float]) -> None:
    along = np.array(axis)
    x = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    pose = tool_pose(Rotation.from_matrix(np.column_stack([x, np.cross(along, x), along])), np.zeros(3))
    found = PoseValues.of(pose)
    assert (found.alpha_rad, abs(found.beta_rad)) == (0.0, pytest.approx(math.pi / 2))
    assert np.allclose(found.pose.as_matrix(), pose.as_matrix())
