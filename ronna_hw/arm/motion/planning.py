"""Planning of joint moves and straight lines, checking branch, ranges and joint speeds along the path.

A path is geometry over a parameter s from 0 to 1, independent of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cbrt, ceil, degrees, pi, radians, sin, sqrt, tau
from typing import Annotated, Protocol

from ronna_hw.arm.errors import MOTION_INVALID, TOO_FAST, OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import RANGE_SLACK_RAD, JointRanges, Kinematics, require_off_base
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.progress import MOST_STEPS, PathLimits, SpeedStep
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector, Quaternion, Vector3

NEARLY_PARALLEL = 0.9999995  # cosine of half a mrad: beyond it slerp divides by almost nothing
SAMPLE_MM = 0.5  # spacing of the checks along a line
SAMPLE_RAD = radians(0.2)
SAMPLED_SHARE = 0.999  # of the joints' limits on a line: between two samples they may move slightly faster
LEAST_SAMPLES = 16  # enough for the second differences of a short line
LEAST_SPEED_FRACTION = 0.05  # of the requested line speed; anything slower is too close to a singularity
PLANNED_SHARE = 0.98  # of acceleration and jerk; the rest is reserved for stops that know only set-points
STANDSTILL_RAD = 1e-9  # a thousandth of the wire's resolution; also used in mm
DEGREES_ADVICE = "Joint angles are in radians; were these degrees? ronna_hw.arm.pose.radians6 converts them."

AROUND_ADVICE = "Go there by a joint move, or by lines via a pose from which all of the way is within reach."


class Path(Protocol):
    """Geometric path from the start of a motion to its target."""

    def joints(self, s: float, near: JointVector) -> JointVector:
        """Return the joint angles at `s` (0..1), unwrapped to be nearest `near`."""


class JointPath:
    """Straight line in joint space: all axes start and stop together."""

    def __init__(self, start_rad: JointVector, target_rad: JointVector) -> None:
        self.start_rad = start_rad
        self.target_rad = target_rad

    def joints(self, s: float, near: JointVector) -> JointVector:
        r = 1.0 - s
        return tuple([r * a + s * b for a, b in zip(self.start_rad, self.target_rad, strict=True)])


class LinePath:
    """Straight tool-centre-point path with slerped orientation, within the starting branch."""

    def __init__(
        self,
        kinematics: Kinematics,
        start_rad: JointVector,
        target: Pose,
        tool_in_flange_mm: Vector3 = (0.0, 0.0, 0.0),
    ) -> None:
        self.kinematics = kinematics
        self.branch = kinematics.branch_of(start_rad)
        begin = kinematics.forward(start_rad)
        self._tool = tool_in_flange_mm
        self._from_mm = begin.apply(tool_in_flange_mm)
        self._to_mm = target.apply(tool_in_flange_mm)
        self._from_q = begin.quaternion()
        to = target.quaternion()
        cosine = sum(a * b for a, b in zip(self._from_q, to, strict=True))
        if cosine < 0.0:  # the shorter way round
            to, cosine = (-to[0], -to[1], -to[2], -to[3]), -cosine
        self._to_q: Quaternion = to
        self._half_angle = acos(min(cosine, 1.0)) if cosine < NEARLY_PARALLEL else 0.0
        self.length_mm = sum((a - b) ** 2 for a, b in zip(self._from_mm, self._to_mm, strict=True)) ** 0.5
        self.angle_rad = begin.angle_rad(target)

    def flange(self, s: float) -> Pose:
        """Return the flange pose at `s`."""
        a, b = self._from_mm, self._to_mm
        r = 1.0 - s
        if self._half_angle:
            over = 1.0 / sin(self._half_angle)
            u, v = sin(r * self._half_angle) * over, sin(s * self._half_angle) * over
        else:
            u, v = r, s
        p, q = self._from_q, self._to_q
        turned = Pose.from_quaternion(
            (0.0, 0.0, 0.0),
            (u * p[0] + v * q[0], u * p[1] + v * q[1], u * p[2] + v * q[2], u * p[3] + v * q[3]),
        )
        x, y, z = turned.apply(self._tool)
        return Pose(
            (r * a[0] + s * b[0] - x, r * a[1] + s * b[1] - y, r * a[2] + s * b[2] - z), turned.rotation
        )

    def joints(self, s: float, near: JointVector) -> JointVector:
        return self.kinematics.solve_branch(self.flange(s), self.branch, near)


@dataclass(frozen=True)
class MotionPlan:
    """Checked motion as plain numbers for the real-time loop. `target` None means a joint move.

    `speed_steps`, if any, say where along the path it must be slower than `limits`.
    """

    start_rad: JointVector
    target_rad: JointVector
    limits: PathLimits
    target: Pose | None = None
    tool_in_flange_mm: Vector3 = (0.0, 0.0, 0.0)
    speed_steps: Annotated[tuple[SpeedStep, ...], MOST_STEPS] = ()

    def path(self, kinematics: Kinematics) -> JointPath | LinePath:
        """Return the path of this plan."""
        if self.target is None:
            return JointPath(self.start_rad, self.target_rad)
        return LinePath(kinematics, self.start_rad, self.target, self.tool_in_flange_mm)

    @property
    def is_standstill(self) -> bool:
        """Whether start and target are the same joint vector."""
        return max(abs(a - b) for a, b in zip(self.start_rad, self.target_rad, strict=True)) < STANDSTILL_RAD


def plan_joint_move(
    arm: JointRanges, start_rad: JointVector, target_rad: JointVector, limits: MotionLimits
) -> MotionPlan:
    """Plan a joint move in which all axes start and stop together. Raises ARM-003 if an end is out of range.

    The ranges form a box, so a straight line between two vectors within them stays inside. The target keeps
    the limits' margin from their ends.
    """
    require_in_range(arm, start_rad)
    _require_within(arm, limits.ranges(arm, start_rad), target_rad, limits.range_margin_rad)
    travel = [abs(b - a) for a, b in zip(start_rad, target_rad, strict=True)]
    return MotionPlan(start_rad, target_rad, _joint_move_limits(travel, limits))


def plan_line(
    kinematics: Kinematics,
    start_rad: JointVector,
    target: Pose,
    limits: MotionLimits,
    tool_in_flange_mm: Vector3 = (0.0, 0.0, 0.0),
) -> MotionPlan:
    """Plan a straight tool-centre-point path to the flange pose `target`, within the starting branch.

    The whole line is slowed so that every joint respects its speed, acceleration and jerk limits. Raises
    ARM-001, ARM-002, ARM-003 if any point of it has no solution, ARM-005 when it would have to be slower than
    a twentieth of the requested line speed.
    """
    require_in_range(kinematics, start_rad)
    require_off_base(target)
    ranges = limits.ranges(kinematics, start_rad)
    line = LinePath(kinematics, start_rad, target, tool_in_flange_mm)
    count = max(LEAST_SAMPLES, ceil(line.length_mm / SAMPLE_MM), ceil(line.angle_rad / SAMPLE_RAD))
    points = [start_rad]
    for k in range(1, count + 1):
        try:
            joints = line.joints(k / count, points[-1])
        except Unreachable as error:
            raise (error if k == count else _on_the_way(kinematics, target, k / count, error)) from None
        _require_within(kinematics, ranges, joints, limits.range_margin_rad)
        for axis, (before, after) in enumerate(zip(points[-1], joints, strict=True)):
            if abs(after - before) > pi:
                raise OutOfJointRange(
                    f"{kinematics.axis_names[axis]} would have to turn beyond its range on the line",
                    got=f"{degrees(before):.1f} deg at {k / count:.0%} of the line",
                )
        points.append(joints)
    wanted_limits = _line_limits(line, limits)
    allowed = _limit_for_joints(points, count, wanted_limits, limits)
    if allowed.velocity < LEAST_SPEED_FRACTION * wanted_limits.velocity:
        raise TOO_FAST(
            "the line passes too close to a singular pose for the speed limits of the axes",
            limit=f"{LEAST_SPEED_FRACTION:.0%} of the line speed",
            got=f"{allowed.velocity / wanted_limits.velocity:.2%}",
        )
    return MotionPlan(start_rad, points[-1], allowed, target, tool_in_flange_mm)


def _on_the_way(kinematics: Kinematics, target: Pose, share: float, error: Unreachable) -> Unreachable:
    """Return the refusal of a line that leaves the reach at a point on its way, or that of its target."""
    try:
        kinematics.solutions(target)
    except Unreachable as of_target:
        return of_target
    except (Singular, OutOfJointRange):
        pass  # within reach
    return Unreachable(
        f"the target is within reach, but not the line to it: at {share:.0%} {error.what}",
        limit=error.limit,
        got=error.got,
        action=AROUND_ADVICE,
    )


def require_in_range(arm: JointRanges, joints_rad: JointVector, limits: MotionLimits | None = None) -> None:
    """Raise ARM-003 naming the first axis out of range, or ARM-006 for a non-numeric value.

    With `limits`, a motion from anywhere may end there: their margin is kept too.
    """
    if limits is None:
        _require_within(arm, (arm.lower_rad, arm.upper_rad), joints_rad)
    else:
        _require_within(arm, limits.ranges(arm), joints_rad, limits.range_margin_rad)


def _require_within(
    arm: JointRanges,
    ranges: tuple[JointVector, JointVector],
    joints_rad: JointVector,
    margin_rad: float = 0.0,
) -> None:
    lower_rad, upper_rad = ranges
    if len(joints_rad) != len(lower_rad):
        names = f"{arm.axis_names[0]} to {arm.axis_names[-1]}"
        raise MOTION_INVALID(
            f"a joint vector of {len(joints_rad)} values", expected=f"{len(lower_rad)}, {names} in rad"
        )
    for axis, (low, angle, high) in enumerate(zip(lower_rad, joints_rad, upper_rad, strict=True)):
        if angle != angle:
            raise MOTION_INVALID(f"{arm.axis_names[axis]} is not a number")
        if not low - RANGE_SLACK_RAD <= angle <= high + RANGE_SLACK_RAD:
            raise OutOfJointRange(
                f"{arm.axis_names[axis]} would leave its range",
                limit=f"{degrees(low):.1f} to {degrees(high):.1f} deg"
                + (f" with the margin of {degrees(margin_rad):g}" if margin_rad else ""),
                got=f"{degrees(angle):.3f} deg",
                action=DEGREES_ADVICE if any(abs(joint_rad) > tau for joint_rad in joints_rad) else None,
            )


def _joint_move_limits(travel: list[float], limits: MotionLimits) -> PathLimits:
    """Return limits on s (0..1) that keep every joint within its own limits over `travel` rad."""
    longest = [max(r, STANDSTILL_RAD) for r in travel]
    return PathLimits(
        min(v / r for v, r in zip(limits.speed_rad_s, longest, strict=True)),
        PLANNED_SHARE * min(a / r for a, r in zip(limits.acceleration_rad_s2, longest, strict=True)),
        PLANNED_SHARE * min(j / r for j, r in zip(limits.jerk_rad_s3, longest, strict=True)),
    )


def _line_limits(line: LinePath, limits: MotionLimits) -> PathLimits:
    length, angle = max(line.length_mm, STANDSTILL_RAD), max(line.angle_rad, STANDSTILL_RAD)
    velocity = min(limits.line_speed_mm_s / length, limits.rotation_rad_s / angle)
    acceleration = min(limits.line_acceleration_mm_s2 / length, limits.rotation_rad_s2 / angle)
    # From rest to rest over s = 0..1 no more than sqrt(acceleration) is reached. On a line of nanometres the
    # velocity itself would turn the rounding of the joint angles into apparent jerk.
    return PathLimits(min(velocity, sqrt(acceleration)), acceleration, acceleration / limits.ramp_s)


def _limit_for_joints(
    points: list[JointVector], count: int, wanted_limits: PathLimits, limits: MotionLimits
) -> PathLimits:
    """Return limits on s, slowed uniformly until every joint respects its speed, acceleration and jerk.

    With derivatives q1, q2, q3 of a joint by s (from differences) and limits v, a, j of s, its speed is at
    most |q1| v, its acceleration |q1| a + |q2| v², its jerk |q1| j + 3 |q2| v a + |q3| v³. Slowing time by k
    divides these by k, k² and k³.
    """
    import numpy as np  # the real-time process, which plans no line, does not need it

    v, a, j = wanted_limits
    angles = np.array(points)  # (samples, axes)
    first = np.diff(angles, axis=0) * count
    second = np.diff(first, axis=0) * count
    third = np.abs(np.diff(second, axis=0) * count)
    first, second = np.abs(first), np.abs(second)
    # The largest of each derivative around a point, so that nothing is missed between two samples.
    q1 = np.maximum(np.maximum(first[:-2], first[1:-1]), first[2:])
    q2 = np.maximum(second[:-1], second[1:])
    speed = (q1 * v / (SAMPLED_SHARE * np.array(limits.speed_rad_s))).max()
    acceleration = ((q1 * a + q2 * v * v) / limits.acceleration_rad_s2).max()
    jerk = ((q1 * j + 3.0 * q2 * v * a + third * v**3) / limits.jerk_rad_s3).max()
    slowdown = max(1.0, float(speed), sqrt(acceleration), cbrt(jerk))
    return PathLimits(v / slowdown, a / slowdown**2, j / slowdown**3)
