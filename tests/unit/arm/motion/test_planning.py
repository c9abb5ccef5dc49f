"""Plans are refused before motion when reach, range, branch or joint speed do not allow them."""

import math
from dataclasses import replace
from typing import Any

import pytest
from coded_errors import raises

from ronna_hw.arm.errors import MOTION_INVALID, TOO_FAST, OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import plan_joint_move, plan_line, require_in_range
from ronna_hw.arm.pose import Pose, degrees6, radians6
from ronna_hw.arm.universal_robots import UR5E, universal_robot

MODEL = kr6_r900(SIXX)
UR5E = universal_robot(UR5E)
LIMITS = working_limits(MODEL)
START = radians6(0, -90, 90, 0, 60, 0)


def _shifted(pose: Pose, x_mm: float, y_mm: float, z_mm: float) -> Pose:
    x, y, z = pose.position_mm
    return Pose((x + x_mm, y + y_mm, z + z_mm), pose.rotation)


def test_working_speed_is_below_an_eighth_of_full_axis_speed() -> None:
    for working, full in zip(LIMITS.speed_rad_s, MODEL.full_speed_rad_s, strict=True):
        assert working < full / 8


def test_a_joint_target_out_of_range_names_the_axis_and_the_limit() -> None:
    limits = r"A5 .* limit -119\.5 to 119\.5 deg with the margin of 0\.5, got 121\.000"
    with pytest.raises(OutOfJointRange, match=limits):
        plan_joint_move(MODEL, START, radians6(0, -90, 90, 0, 121, 0), LIMITS)


@pytest.mark.parametrize(("turned_deg", "axis"), [(0.0, "A2"), (5.0, "A1"), (170.0, "A1"), (-360.0, "A1")])
def test_a_joint_target_in_degrees_is_suspected(turned_deg: float, axis: str) -> None:
    suspected = rf"{axis} would leave its range.*Joint angles are in radians; were these degrees"
    with pytest.raises(OutOfJointRange, match=suspected):
        plan_joint_move(MODEL, START, (turned_deg, -75.0, 99.0, 0.0, 66.0, 180.0), LIMITS)
    with pytest.raises(OutOfJointRange, match="Choose another branch"):
        plan_joint_move(MODEL, START, radians6(0, 60, 90, 0, 45, 0), LIMITS)


def test_motions_keep_a_margin_from_the_ends_of_the_ranges() -> None:
    inside, beyond = radians6(0, -90, 90, 0, 119.4, 0), radians6(0, -90, 90, 0, 119.6, 0)
    plan_joint_move(MODEL, START, inside, LIMITS)
    with pytest.raises(OutOfJointRange):
        plan_joint_move(MODEL, START, beyond, LIMITS)
    plan_joint_move(MODEL, START, beyond, replace(LIMITS, range_margin_rad=math.radians(0.2)))
    bent = radians6(0, -90, 90, 0, 110, 0)
    nearer = MODEL.forward(radians6(0, -90, 90, 0, 119.6, 0))
    with pytest.raises(OutOfJointRange, match=r"A5 would leave its range; limit -119\.5"):
        plan_line(MODEL, bent, nearer, LIMITS)


def test_an_arm_inside_the_margin_may_stay_or_leave_but_not_go_further() -> None:
    at_end = radians6(0, -90, 90, 0, 119.8, 0)
    lower, upper = LIMITS.ranges(MODEL, at_end)
    assert (upper[4], lower[4]) == (at_end[4], pytest.approx(math.radians(-119.5)))
    plan_joint_move(MODEL, at_end, radians6(10, -90, 90, 0, 119.8, 0), LIMITS)
    plan_joint_move(MODEL, at_end, START, LIMITS)
    with pytest.raises(OutOfJointRange):
        plan_joint_move(MODEL, at_end, radians6(0, -90, 90, 0, 119.9, 0), LIMITS)


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        *((joints, f"of {len(joints)} values") for joints in ((), (0.0,) * 5, (0.0,) * 7)),
        ((0.0, math.nan, 0.0, 0.0, 0.0, 0.0), "A2 is not a number"),
    ],
)
def test_a_vector_of_other_than_six_numbers_is_refused(joints: tuple[float, ...], said: str) -> None:
    with raises(MOTION_INVALID, match=said):
        require_in_range(MODEL, joints)  # type: ignore[arg-type]
    with raises(MOTION_INVALID, match=said):
        plan_joint_move(MODEL, START, joints, LIMITS)  # type: ignore[arg-type]


@pytest.mark.parametrize("fraction", [0.0, -1.0, 1.01, 10, math.nan, "10%", None])
def test_a_speed_fraction_outside_its_range_is_refused(fraction: Any) -> None:
    with raises(MOTION_INVALID, match="ARM-006: a speed fraction must be above 0 and at most 1"):
        LIMITS.slowed(fraction)


def test_half_the_speed_fraction_gives_half_the_speed() -> None:
    target = radians6(30, -80, 80, 0, 60, 0)
    whole = plan_joint_move(MODEL, START, target, LIMITS)
    half = plan_joint_move(MODEL, START, target, LIMITS.slowed(0.5))
    assert half.limits.velocity == pytest.approx(whole.limits.velocity / 2)
    assert half.limits.acceleration == whole.limits.acceleration


def test_a_line_out_of_reach_is_refused() -> None:
    with pytest.raises(Unreachable):
        plan_line(MODEL, START, _shifted(MODEL.forward(START), 900, 0, 0), LIMITS)


@pytest.mark.parametrize("arm", [MODEL, UR5E], ids=["kuka", "ur"])
def test_a_target_in_metres_is_suspected(arm: Kinematics) -> None:
    target = Pose((0.4, -0.2, 0.3), arm.forward(arm.home_rad).rotation)
    suspected = r"target at x 0\.4 mm, y -0\.2 mm, z 0\.3 mm is inside the base.*were these metres\?"
    with pytest.raises(Unreachable, match=suspected):
        plan_line(arm, arm.home_rad, target, working_limits(arm))
    with pytest.raises(Unreachable, match=suspected):
        arm.solutions(target)


def test_a_line_whose_target_alone_is_within_reach_says_where_it_leaves_it() -> None:
    begin = UR5E.forward(UR5E.home_rad)
    x, y, z = begin.position_mm
    beyond_the_base = Pose((-x, -y, z), begin.rotation)
    said = r"within reach, but not the line to it: at \d+% the wrist is too close to the base axis; "
    with pytest.raises(Unreachable, match=said + r"limit at least 133\.\d mm, got 13\d\.\d mm"):
        plan_line(UR5E, UR5E.home_rad, beyond_the_base, working_limits(UR5E))
    with pytest.raises(Unreachable, match=r"ARM-001: wrist 1 is too far from the shoulder; limit at most"):
        plan_line(UR5E, UR5E.home_rad, _shifted(begin, 900, 0, 0), working_limits(UR5E))


@pytest.mark.hazard(22)
def test_a_line_through_the_aligned_wrist_is_refused() -> None:
    start = radians6(0, -90, 90, 0, 10, 0)
    target = MODEL.forward(radians6(0, -90, 90, 0, -10, 0))
    with raises(Singular, TOO_FAST, OutOfJointRange):
        plan_line(MODEL, start, target, LIMITS)


def test_a_line_close_to_the_aligned_wrist_is_too_fast_for_the_joints() -> None:
    start = radians6(0, -90, 90, 1.0, 10, 0)
    begin = MODEL.forward(start)
    target = MODEL.forward(radians6(0, -90, 90, 1.0, -10, 0))
    with raises(TOO_FAST, match="singular") as caught:
        plan_line(MODEL, start, Pose(begin.position_mm, target.rotation), LIMITS)
    assert caught.value.code == "ARM-005"


@pytest.mark.hazard(22)
def test_a_line_near_a_singularity_is_slowed_for_the_joints() -> None:
    start = radians6(0, -90, 90, 30, 12, 0)
    target = _shifted(MODEL.forward(start), 0, 60, 0)
    plan = plan_line(MODEL, start, target, LIMITS)
    assert plan.limits.velocity * 60.0 < 0.9 * LIMITS.line_speed_mm_s


def test_a_line_that_needs_a_whole_turn_of_the_wrist_is_refused() -> None:
    start = radians6(0, -90, 90, 0, 60, 340)
    target = MODEL.forward(start).compose(Pose.from_kuka(0, 0, 0, -30, 0, 0))
    to_the_ends = replace(LIMITS, range_margin_rad=0.0)
    with pytest.raises(OutOfJointRange, match="A6 would have to turn beyond"):
        plan_line(MODEL, start, target, to_the_ends)
    with pytest.raises(OutOfJointRange, match=r"A6 would leave its range; limit -349\.5 to 349\.5 deg"):
        plan_line(MODEL, start, target, LIMITS)
    back = MODEL.forward(start).compose(Pose.from_kuka(0, 0, 0, 30, 0, 0))
    assert degrees6(plan_line(MODEL, start, back, LIMITS).target_rad)[5] == pytest.approx(310)


def test_a_motion_to_the_current_position_is_a_standstill() -> None:
    assert plan_joint_move(MODEL, START, START, LIMITS).is_standstill
    assert plan_line(MODEL, START, MODEL.forward(START), LIMITS).is_standstill
    assert not plan_line(MODEL, START, _shifted(MODEL.forward(START), 0, 0, 1e-3), LIMITS).is_standstill


@pytest.mark.parametrize("length_mm", [1e-2, 1e-3, 1e-4, 1e-5])
def test_a_line_of_nanometres_is_not_taken_for_one_near_a_singularity(length_mm: float) -> None:
    far = plan_line(MODEL, START, _shifted(MODEL.forward(START), 0.0, 0.0, 1.0), LIMITS)
    plan = plan_line(MODEL, START, _shifted(MODEL.forward(START), 0.0, 0.0, length_mm), LIMITS)
    assert plan.limits.acceleration * length_mm == pytest.approx(far.limits.acceleration, rel=1e-3)
