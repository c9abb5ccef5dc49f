"""Approach and retreat: straight on along an axis of the tool, with its orientation kept."""

from __future__ import annotations

from math import dist
from typing import Any

import pytest

from ronna_hw.arm.angles import radians6
from ronna_hw.arm.errors import MotionInvalid, OutOfJointRange, Unreachable
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import plan_along_tool, pose_along_tool
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Vector3
from ronna_hw.frames import Frame, Transform

MODEL = kr6_r900("kr6_r900_sixx")
LIMITS = working_limits(MODEL)
START = radians6(0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
TOOL = Pose.from_kuka(220.0, 0.0, 60.0, 0.0, 90.0, 0.0)  # its z along the flange's x
FRAMED = Transform.of(
    Frame.FLANGE, Frame.TOOL, translation_mm=TOOL.position_mm, quaternion_wxyz=TOOL.quaternion()
)
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 2.0)


@pytest.mark.parametrize("axis", [X, Z, (0.3, -0.4, 0.5)])
@pytest.mark.parametrize("distance_mm", [40.0, -40.0])
def test_the_tool_goes_straight_along_its_axis_and_keeps_its_orientation(
    axis: Vector3, distance_mm: float
) -> None:
    plan = plan_along_tool(MODEL, START, distance_mm, LIMITS, TOOL, axis)
    path, joints = plan.path(MODEL), START
    begin = MODEL.forward(START).compose(TOOL)
    end = begin.apply(tuple(distance_mm * part / dist(axis, (0, 0, 0)) for part in axis))  # type: ignore[arg-type]
    for n in range(1, 11):
        joints = path.joints(n / 10, joints)
        tool = MODEL.forward(joints).compose(TOOL)
        wanted = tuple(a + n / 10 * (b - a) for a, b in zip(begin.position_mm, end, strict=True))
        assert tool.position_mm == pytest.approx(wanted, abs=1e-6)
        assert tool.rotation == pytest.approx(begin.rotation, abs=1e-9)


def test_an_axis_without_direction_and_a_goal_out_of_reach_are_refused() -> None:
    for axis in ((0.0, 0.0, 0.0), (0.0, 0.0, float("nan")), (0.0, float("inf"), 0.0)):
        with pytest.raises(MotionInvalid, match="no direction"):
            pose_along_tool(MODEL, START, 10.0, TOOL, axis)
    with pytest.raises((Unreachable, OutOfJointRange)):
        plan_along_tool(MODEL, START, 900.0, LIMITS, TOOL)


def test_the_arm_approaches_and_retreats_to_where_it_was(controller: Any, active_arm: Any) -> None:
    pose = pose_along_tool(MODEL, START, 20.0, TOOL)
    there = active_arm.move_along_tool(20.0, flange_from_tool=FRAMED)
    reached = MODEL.forward(there.joints_rad)
    assert reached.position_mm == pytest.approx(pose.position_mm, abs=0.01)
    back = active_arm.move_along_tool(-20.0, flange_from_tool=FRAMED)
    assert back.joints_rad == pytest.approx(START, abs=1e-5)
