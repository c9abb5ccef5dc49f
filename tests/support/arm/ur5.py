"""A Universal Robots UR5 behind the arm's neutral interface: parallel shoulder axes, an offset wrist.

Standard DH figures and closed form as the vendor and the field publish them. For tests only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import acos, asin, atan2, cos, hypot, pi, sin, tau

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import (
    COLUMN_NAME,
    RANGE_SLACK_RAD,
    ArmPart,
    Branch,
    Chain,
    Joint,
    Link,
    Segment,
    SingularMeasure,
    Solution,
)
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, Vector3

A2, A3 = -425.0, -392.25
D1, D4, D5, D6 = 89.159, 109.15, 94.65, 82.3
ALPHA = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
A = (0.0, A2, A3, 0.0, 0.0, 0.0)
D = (D1, 0.0, 0.0, D4, D5, D6)
SHOULDER_ASIDE_MM, FOREARM_ASIDE_MM = 135.85, 16.15  # of the tubes, beside the plane of the first axis
BEHIND, BENT_BACK, TURNED = 1, 2, 4  # bits of the branch: wrist behind axis 1, sin q3 < 0, sin q5 < 0
SINGULAR_SINE = 1e-7
MINUS_Y, Z, MINUS_Z = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
ORIGIN: Vector3 = (0.0, 0.0, 0.0)


def _link(number: int, q: float) -> Pose:
    """Rz(q) Tz(d) Tx(a) Rx(alpha)."""
    c, s, ca, sa = cos(q), sin(q), cos(ALPHA[number]), sin(ALPHA[number])
    a, d = A[number], D[number]
    return Pose((a * c, a * s, d), (c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca))


def _product(joints: Sequence[float], first: int = 0) -> Pose:
    pose = Pose()
    for number, q in enumerate(joints, start=first):
        pose = pose.compose(_link(number, q))
    return pose


class Ur5:
    """Nominal figures; accelerations are not published, so a cautious one stands in."""

    name = "ur5"
    axis_names = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
    lower_rad = radians6(-360, -360, -180, -360, -360, -360)
    upper_rad = radians6(360, 360, 180, 360, 360, 360)
    full_speed_rad_s = radians6(180, 180, 180, 180, 180, 180)
    acceleration_rad_s2: JointVector = (20.0, 20.0, 20.0, 20.0, 20.0, 20.0)
    home_rad = radians6(0, -90, -90, -90, 90, 0)
    branches = tuple(Branch(number) for number in range(8))
    column_height_mm = D1
    chain = Chain(
        base_mm=(0.0, 0.0, D1),
        joints=(
            Joint(Z, ORIGIN),
            Joint(MINUS_Y, (A2, 0.0, 0.0)),
            Joint(MINUS_Y, (A3, 0.0, 0.0)),
            Joint(MINUS_Y, (0.0, -D4, 0.0)),
            Joint(MINUS_Z, (0.0, 0.0, -D5)),
            Joint(MINUS_Y, (0.0, -D6, 0.0)),
        ),
        flange_rotation=(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
    )
    links = (
        Link(
            "upper arm",
            ArmPart.UPPER_ARM,
            1,
            (0.0, -SHOULDER_ASIDE_MM, 0.0),
            (A2, -SHOULDER_ASIDE_MM, 0.0),
            (COLUMN_NAME,),
        ),
        Link(
            "forearm",
            ArmPart.FOREARM,
            2,
            (0.0, -FOREARM_ASIDE_MM, 0.0),
            (A3, -FOREARM_ASIDE_MM, 0.0),
            ("upper arm",),
        ),
        Link("wrist 1", ArmPart.WRIST, 3, (0.0, -FOREARM_ASIDE_MM, 0.0), (0.0, -D4, 0.0), ("forearm",)),
        Link("wrist 2", ArmPart.WRIST, 4, ORIGIN, (0.0, 0.0, -D5), ("forearm", "wrist 1")),
        Link("hand", ArmPart.HAND, 5, ORIGIN, (0.0, -D6, 0.0), ("wrist 1", "wrist 2")),
    )

    def forward(self, joints_rad: JointVector) -> Pose:
        return _product(joints_rad)

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        return self.forward(joints_rad).to_transform()

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        flange = np.array(self.forward(joints_rad).position_mm)
        result = np.empty((6, 6))
        for axis in range(6):
            frame = _product(joints_rad[:axis])
            direction = np.array(frame.rotation[2::3])
            result[:3, axis] = np.cross(direction, flange - frame.position_mm)
            result[3:, axis] = direction
        return result

    def branch_of(self, joints_rad: JointVector) -> Branch:
        behind = _ahead_mm(joints_rad) < 0.0
        return Branch(
            BEHIND * behind + BENT_BACK * (sin(joints_rad[2]) < 0.0) + TURNED * (sin(joints_rad[4]) < 0.0)
        )

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        found: list[Solution] = []
        unreachable: Unreachable | None = None
        for branch in self.branches:
            try:
                joints = _solve(pose, branch)
            except Unreachable as error:
                unreachable = error
                continue
            found += [Solution(branch, one) for one in self._turns(joints)]
        if found:
            return tuple(found)
        raise unreachable or OutOfJointRange("every branch leaves the joint ranges")

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        joints = _solve(pose, branch)
        a, b, c, d, e, f = (
            _nearest_turn(*one) for one in zip(joints, near, self.lower_rad, self.upper_rad, strict=True)
        )
        return (a, b, c, d, e, f)

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        shoulder = abs(_ahead_mm(joints_rad)) / (abs(A2) + abs(A3) + D5)
        return SingularMeasure(abs(sin(joints_rad[4])), abs(sin(joints_rad[2])), shoulder)

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        return asin(abs(sin(joints_rad[4])))

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        return joints_rad[3]

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        q1, q2, q3, q4, _, _ = joints_rad
        c1, s1 = cos(q1), sin(q1)

        def at(ahead_mm: float, up_mm: float, aside_mm: float) -> Vector3:
            return (c1 * ahead_mm + s1 * aside_mm, s1 * ahead_mm - c1 * aside_mm, up_mm)

        elbow = A2 * cos(q2), D1 + A2 * sin(q2)
        wrist = elbow[0] + A3 * cos(q2 + q3), elbow[1] + A3 * sin(q2 + q3)
        last = wrist[0] + D5 * sin(q2 + q3 + q4), wrist[1] - D5 * cos(q2 + q3 + q4)
        flange = self.forward(joints_rad)
        return [
            (at(0.0, D1, SHOULDER_ASIDE_MM), at(*elbow, SHOULDER_ASIDE_MM)),
            (at(*elbow, FOREARM_ASIDE_MM), at(*wrist, FOREARM_ASIDE_MM)),
            (at(*wrist, FOREARM_ASIDE_MM), at(*wrist, D4)),
            (at(*wrist, D4), at(*last, D4)),
            (at(*last, D4), flange.position_mm),
        ], flange

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        about_last = max((hypot(x, y) for x, y, _ in tool_points_mm), default=0.0)
        beyond = max((hypot(x, y, z + D6) for x, y, z in tool_points_mm), default=0.0)
        about_wrist_2 = max(beyond, D6)
        about_wrist_1 = about_wrist_2 + D5
        about_elbow = about_wrist_1 + abs(A3)
        about_shoulder = about_elbow + abs(A2)
        return (
            about_shoulder + SHOULDER_ASIDE_MM,
            about_shoulder,
            about_elbow,
            about_wrist_1,
            about_wrist_2,
            about_last,
        )

    def _turns(self, joints: JointVector) -> Iterator[JointVector]:
        choices = [
            [turned for turned in (q, q - tau, q + tau) if low <= turned <= high]
            for q, low, high in zip(joints, self.lower_rad, self.upper_rad, strict=True)
        ]
        yield from product(*choices)  # type: ignore[misc]


def _ahead_mm(joints_rad: JointVector) -> float:
    """Signed distance from axis 1 to the centre of the last joint, in the plane of the upper arm."""
    _, q2, q3, q4, _, _ = joints_rad
    return A2 * cos(q2) + A3 * cos(q2 + q3) + D5 * sin(q2 + q3 + q4)


def _solve(pose: Pose, branch: Branch) -> JointVector:
    """Joint angles within half a turn; raises ARM-001 or ARM-002."""
    x, y, _ = pose.apply((0.0, 0.0, -D6))
    radius = hypot(x, y)
    if abs(radius - D4) < 1e-6:
        raise Singular("the wrist is over the first axis")
    if radius < D4:
        raise Unreachable(
            "the wrist is too close to the first axis", limit=f"{D4} mm", got=f"{radius:.1f} mm"
        )
    beside = acos(D4 / radius)
    q1 = _within(atan2(y, x) + (beside if branch & BEHIND else -beside) + pi / 2)
    c1, s1 = cos(q1), sin(q1)
    px, py, _ = pose.position_mm
    bend = acos(min(1.0, max(-1.0, (px * s1 - py * c1 - D4) / D6)))
    if abs(sin(bend)) < SINGULAR_SINE:
        raise Singular("wrist 1 and wrist 3 are in line")
    q5 = -bend if branch & TURNED else bend
    r, s5 = pose.rotation, sin(q5)
    q6 = atan2((-r[1] * s1 + r[4] * c1) / s5, (r[0] * s1 - r[3] * c1) / s5)
    hand = _product((q5, q6), first=4)
    upto_wrist = _link(0, q1).inverse().compose(pose).compose(hand.inverse())
    wx, wy, _ = upto_wrist.apply((0.0, -D4, 0.0))
    length = hypot(wx, wy)
    cosine = (length * length - A2 * A2 - A3 * A3) / (2.0 * A2 * A3)
    if abs(cosine) > 1.0:
        raise Unreachable("the wrist is out of the elbow's reach", got=f"{length:.1f} mm")
    fold = acos(cosine)
    if sin(fold) < SINGULAR_SINE:
        raise Singular("upper arm and forearm are in line")
    q3 = -fold if branch & BENT_BACK else fold
    q2 = _within(atan2(-wy, -wx) - asin(-A3 * sin(q3) / length))
    last = _product((q2, q3), first=1).inverse().compose(upto_wrist)
    return (q1, q2, q3, atan2(last.rotation[3], last.rotation[0]), q5, q6)


def _within(angle: float) -> float:
    return angle - tau * round(angle / tau)


def _nearest_turn(angle: float, near: float, low: float, high: float) -> float:
    angle += tau * round((near - angle) / tau)
    if angle > high + RANGE_SLACK_RAD:
        return angle - tau
    return angle + tau if angle < low - RANGE_SLACK_RAD else angle
