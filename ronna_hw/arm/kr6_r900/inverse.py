"""Closed-form inverse kinematics of the KR 6 R900, branch by branch.

The wrist is spherical, so A1..A3 follow from the wrist centre (two sides of A1, two bends of the elbow) and
A4..A6 from the remaining orientation (two flips of the wrist). A4 and A6 turn more than a full circle: each
branch includes all whole turns within the joint range.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import acos, atan2, cos, degrees, hypot, pi, sin
from typing import NamedTuple

from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import RANGE_SLACK_RAD, Branch, Solution
from ronna_hw.arm.kr6_r900.geometry import Kr6Dimensions
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector

TURN = 2.0 * pi
SINGULAR_A5_RAD = 1e-7  # below this, rounding decides A4 - A6; joint speed limits how close a path may come
SINGULAR_AXIS_MM = 1e-3  # wrist centre on the axis of A1
STRETCH_COSINE = 5e-13  # one minus the cosine of 1e-6 rad: the two bends of the elbow coincide


# The branch is KUKA's status S, with these bits:
OVERHEAD = 1  # the wrist centre is behind the axis of A1
ELBOW = 2  # A3 at or above its stretched angle
FLIPPED = 4  # A5 not positive


def branch(*, overhead: bool, elbow: bool, flipped: bool) -> Branch:
    """Build the branch from its status bits."""
    return Branch(OVERHEAD * overhead + ELBOW * elbow + FLIPPED * flipped)


BRANCHES = tuple(
    branch(overhead=overhead, elbow=elbow, flipped=flipped)
    for overhead in (False, True)
    for elbow in (True, False)
    for flipped in (False, True)
)


def branch_of(arm: Kr6Dimensions, joints_rad: JointVector) -> Branch:
    """Return the branch of a joint vector."""
    _, A2, A3, _, A5, _ = joints_rad
    overhead = arm.wrist_ahead_mm(A2, A3) < 0.0
    return branch(overhead=overhead, elbow=arm.stretched_A3_rad <= A3, flipped=A5 <= 0.0)


def solutions(arm: Kr6Dimensions, pose: Pose) -> tuple[Solution, ...]:
    """Return all joint vectors within range that reach the flange pose, branch by branch.

    Raises ARM-001 when the wrist centre is out of reach; ARM-002 when A1, A4 and A6 or the bend of the elbow
    are undefined in a branch within the ranges; ARM-003 when no branch fits the joint ranges.
    """
    found: list[Solution] = []
    singular: Singular | None = None
    reached = False
    for overhead in (False, True):
        try:
            shoulder = _shoulder(arm, pose, overhead)
        except Unreachable:
            continue
        reached = True
        for elbow in (True, False):
            if (first := _into_range(arm, _bend(arm, shoulder, elbow))) is None:
                continue
            try:
                for flipped in (False, True):
                    here = branch(overhead=overhead, elbow=elbow, flipped=flipped)
                    wrist = _wrist(pose, first, flipped)
                    found += [Solution(here, (*first, *rest)) for rest in _turns(arm, wrist)]
            except Singular as error:
                singular = error
    if not reached:
        raise _unreachable(arm, pose)
    if singular is not None:
        raise singular
    if not found:
        raise OutOfJointRange("the pose is within reach, but every branch is outside the joint ranges")
    return tuple(found)


def solve_branch(arm: Kr6Dimensions, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
    """Return the solution in `branch`, unwrapped to be nearest `near`, for path following.

    Raises ARM-001, ARM-002 or ARM-003 like `solutions`, for this branch alone.
    """
    try:
        shoulder = _shoulder(arm, pose, bool(branch & OVERHEAD))
    except Unreachable:
        raise _unreachable(arm, pose) from None
    bent = _bend(arm, shoulder, bool(branch & ELBOW))
    if (first := _into_range(arm, bent)) is None:
        raise _out_of_range(arm, bent)
    A4, A5, A6 = _wrist(pose, first, bool(branch & FLIPPED))
    A4 = _nearest_turn(A4, near[3], arm.lower_rad[3], arm.upper_rad[3])
    A6 = _nearest_turn(A6, near[5], arm.lower_rad[5], arm.upper_rad[5])
    if not arm.lower_rad[4] - RANGE_SLACK_RAD <= A5 <= arm.upper_rad[4] + RANGE_SLACK_RAD:
        raise _out_of_range(arm, (*first, A4, A5, A6))
    return (*first, A4, A5, A6)


class _Shoulder(NamedTuple):
    A1: float
    elevation: float  # of the wrist centre seen from A2, measured like A2
    inner: float  # angle at A2 between upper arm and wrist centre, not negative
    bend: float  # angle of A3 away from stretched, not negative


def _shoulder(arm: Kr6Dimensions, pose: Pose, overhead: bool) -> _Shoulder:
    (px, py, pz), r, hand = pose.position_mm, pose.rotation, arm.flange_mm
    x, y, z = px - hand * r[2], py - hand * r[5], pz - hand * r[8]
    if (radius := hypot(x, y)) < SINGULAR_AXIS_MM:
        raise Singular("the wrist centre is on the axis of A1", limit=f"{SINGULAR_AXIS_MM} mm")
    if overhead:
        A1 = atan2(y, -x)
        ahead = -radius - arm.shoulder_offset_mm
    else:
        A1 = -atan2(y, x)
        ahead = radius - arm.shoulder_offset_mm
    below = arm.base_height_mm - z
    upper, lower = arm.upper_arm_mm, arm.elbow_to_wrist_mm
    square = ahead * ahead + below * below
    cosine = (square - upper * upper - lower * lower) / (2.0 * upper * lower)
    if (excess := abs(cosine) - 1.0) > STRETCH_COSINE:
        raise Unreachable("the wrist centre is out of reach")
    if excess > -STRETCH_COSINE:
        raise Singular("the elbow is stretched or folded flat", limit="a bend of 1e-6 rad")
    bend = acos(cosine)
    return _Shoulder(A1, atan2(below, ahead), atan2(lower * sin(bend), upper + lower * cosine), bend)


def _bend(arm: Kr6Dimensions, shoulder: _Shoulder, elbow: bool) -> tuple[float, float, float]:
    if elbow:
        return (shoulder.A1, shoulder.elevation - shoulder.inner, arm.stretched_A3_rad + shoulder.bend)
    return (shoulder.A1, shoulder.elevation + shoulder.inner, arm.stretched_A3_rad - shoulder.bend)


def _into_range(arm: Kr6Dimensions, first: tuple[float, float, float]) -> tuple[float, float, float] | None:
    """Shift A1..A3 into range by whole turns, or return None; each range is shorter than a turn."""
    result = []
    for axis, angle in enumerate(first):
        low, high = arm.lower_rad[axis] - RANGE_SLACK_RAD, arm.upper_rad[axis] + RANGE_SLACK_RAD
        if angle > high:
            angle -= TURN
        elif angle < low:
            angle += TURN
        if not low <= angle <= high:
            return None
        result.append(angle)
    return (result[0], result[1], result[2])


def _wrist(pose: Pose, first: tuple[float, float, float], flipped: bool) -> tuple[float, float, float]:
    A1, A2, A3 = first
    r = pose.rotation
    c1, s1 = cos(A1), sin(A1)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    # Components of the flange's axes along the forearm (x), along the elbow's axis (y) and across (z).
    ahead = c1 * r[2] - s1 * r[5]
    zx = c23 * ahead - s23 * r[8]
    zy = s1 * r[2] + c1 * r[5]
    zz = s23 * ahead + c23 * r[8]
    xx = c23 * (c1 * r[0] - s1 * r[3]) - s23 * r[6]
    yx = c23 * (c1 * r[1] - s1 * r[4]) - s23 * r[7]
    if (sine := hypot(zy, zz)) < SINGULAR_A5_RAD:
        raise Singular("A4 and A6 are aligned", limit=f"A5 {SINGULAR_A5_RAD} rad", got=f"{sine:.2e} rad")
    if flipped:
        return (atan2(zy, zz), -atan2(sine, zx), atan2(yx, xx))
    return (atan2(-zy, -zz), atan2(sine, zx), atan2(-yx, -xx))


def _turns(arm: Kr6Dimensions, wrist: tuple[float, float, float]) -> Iterator[tuple[float, float, float]]:
    A4, A5, A6 = wrist
    low, high = arm.lower_rad, arm.upper_rad
    if not low[4] - RANGE_SLACK_RAD <= A5 <= high[4] + RANGE_SLACK_RAD:
        return
    for fourth in (A4, A4 - TURN, A4 + TURN):
        if low[3] - RANGE_SLACK_RAD <= fourth <= high[3] + RANGE_SLACK_RAD:
            for sixth in (A6, A6 - TURN, A6 + TURN):
                if low[5] - RANGE_SLACK_RAD <= sixth <= high[5] + RANGE_SLACK_RAD:
                    yield (fourth, A5, sixth)


def _nearest_turn(angle: float, near: float, low: float, high: float) -> float:
    angle += TURN * round((near - angle) / TURN)
    if angle > high + RANGE_SLACK_RAD:
        angle -= TURN
    elif angle < low - RANGE_SLACK_RAD:
        angle += TURN
    return angle


def _unreachable(arm: Kr6Dimensions, pose: Pose) -> Unreachable:
    (px, py, pz), r, hand = pose.position_mm, pose.rotation, arm.flange_mm
    x, y, z = px - hand * r[2], py - hand * r[5], pz - hand * r[8]
    distance = hypot(hypot(x, y) - arm.shoulder_offset_mm, z - arm.base_height_mm)
    longest = arm.upper_arm_mm + arm.elbow_to_wrist_mm
    shortest = abs(arm.upper_arm_mm - arm.elbow_to_wrist_mm)
    return Unreachable(
        "the wrist centre is out of reach of A2",
        limit=f"{shortest:.1f} to {longest:.1f} mm",
        got=f"{distance:.1f} mm",
    )


def _out_of_range(arm: Kr6Dimensions, joints_rad: tuple[float, ...]) -> OutOfJointRange:
    for axis, angle in enumerate(joints_rad):
        low, high = arm.lower_rad[axis], arm.upper_rad[axis]
        if angle > high and angle - TURN >= low:
            angle -= TURN
        elif angle < low and angle + TURN <= high:
            angle += TURN
        if not low <= angle <= high:
            return OutOfJointRange(
                f"A{axis + 1} would leave its range",
                limit=f"{degrees(low):.1f} to {degrees(high):.1f} deg",
                got=f"{degrees(angle):.3f} deg",
            )
    return OutOfJointRange("a joint would leave its range")
