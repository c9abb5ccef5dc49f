"""Nominal `Kinematics` of the Universal Robots arms in closed form, written out for the real-time loop."""

from __future__ import annotations

from collections.abc import Sequence
from math import asin, cos, hypot, sin
from typing import TYPE_CHECKING

from ronna_hw.arm.errors import Singular, Unreachable
from ronna_hw.arm.kinematics import (
    COLUMN_NAME,
    ArmPart,
    Branch,
    Chain,
    Joint,
    Link,
    Segment,
    SingularMeasure,
    Solution,
    require_off_base,
)
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.arm.universal_robots import inverse
from ronna_hw.arm.universal_robots.geometry import (
    ACCELERATION_RAD_S2,
    DIMENSIONS,
    Dimensions,
)
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

# Elbow up, flange ahead of the base along x and facing down, its x axis ahead.
HOME_RAD = radians6(0.0, -90.0, -90.0, -90.0, 90.0, -90.0)
SHOULDER, UPPER_ARM, ELBOW, FOREARM = "shoulder", "upper arm", "elbow", "forearm"
WRIST_1, WRIST_2, HAND = "wrist 1", "wrist 2", "hand"
MINUS_Y, Z, MINUS_Z = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
ORIGIN: Vector3 = (0.0, 0.0, 0.0)


class UniversalRobot:
    """Nominal kinematics of one model.

    Branches combine the side of the base axis, the bend of the elbow and the flip of the wrist.
    """

    axis_names = inverse.AXIS_NAMES
    home_rad = HOME_RAD
    branches = inverse.BRANCHES
    acceleration_rad_s2 = ACCELERATION_RAD_S2

    def __init__(self, dimensions: Dimensions) -> None:
        self.dimensions = dimensions
        self.name = dimensions.name
        self.lower_rad = dimensions.lower_rad
        self.upper_rad = dimensions.upper_rad
        self.full_speed_rad_s = dimensions.full_speed_rad_s
        self.radii = dimensions.radii
        self.chain = _chain(dimensions)
        self.links = _links(dimensions)
        self.column_height_mm = dimensions.d1_mm

    def forward(self, joints_rad: JointVector) -> Pose:
        """Return the flange pose in the base; z points out of the flange.

        The product of the six DH transforms, multiplied out.
        """
        arm = self.dimensions
        q1, q2, q3, q4, q5, q6 = joints_rad
        c1, s1 = cos(q1), sin(q1)
        q23 = q2 + q3
        cp, sp = cos(q23 + q4), sin(q23 + q4)
        c5, s5 = cos(q5), sin(q5)
        c6, s6 = cos(q6), sin(q6)
        # Axes of the flange in the plane of the arm: ahead (u), up, and along the parallel axes (n).
        x_u, x_up, x_n = c6 * c5 * cp - s6 * sp, c6 * c5 * sp + s6 * cp, c6 * s5
        y_u, y_up, y_n = -s6 * c5 * cp - c6 * sp, -s6 * c5 * sp + c6 * cp, -s6 * s5
        z_u, z_up, z_n = -s5 * cp, -s5 * sp, c5
        u = arm.a2_mm * cos(q2) + arm.a3_mm * cos(q23) + arm.d5_mm * sp + arm.d6_mm * z_u
        up = arm.d1_mm + arm.a2_mm * sin(q2) + arm.a3_mm * sin(q23) - arm.d5_mm * cp + arm.d6_mm * z_up
        n = arm.d4_mm + arm.d6_mm * z_n
        return Pose(
            (c1 * u + s1 * n, s1 * u - c1 * n, up),
            (
                c1 * x_u + s1 * x_n,
                c1 * y_u + s1 * y_n,
                c1 * z_u + s1 * z_n,
                s1 * x_u - c1 * x_n,
                s1 * y_u - c1 * y_n,
                s1 * z_u - c1 * z_n,
                x_up,
                y_up,
                z_up,
            ),
        )

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        return self.forward(joints_rad).to_transform()

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        return chain_jacobian(self.dimensions.links, joints_rad)

    def closed_form(self, pose: Pose, branch: Branch) -> JointVector:
        """Return the joint angles of a branch, up to whole turns. Raises ARM-001 or ARM-002."""
        return inverse.closed_form(self.dimensions, pose, branch)

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        require_off_base(pose)
        found: list[Solution] = []
        unreachable: Unreachable | None = None
        singular: Singular | None = None
        for branch in self.branches:
            try:
                found.append(Solution(branch, self.closed_form(pose, branch)))
            except Unreachable as error:
                unreachable = error
            except Singular as error:
                singular = error
        if singular is not None:
            raise singular
        if unreachable is not None and not found:
            raise unreachable
        return inverse.solutions(self.dimensions, found)

    def branch_of(self, joints_rad: JointVector) -> Branch:
        return inverse.branch_of(self.dimensions, joints_rad)

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        return inverse.nearest_turns(self.dimensions, self.closed_form(pose, branch), near)

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        """Return the distances from singularity.

        `wrist` and `elbow` are |sin| of wrist 2 and elbow. `shoulder` is the distance of the wrist 3 axis
        from the base axis in the plane of the arm as a share of the reach.
        """
        shoulder = abs(inverse.ahead_mm(self.dimensions, joints_rad)) / self.dimensions.reach_mm
        return SingularMeasure(abs(sin(joints_rad[4])), abs(sin(joints_rad[2])), shoulder)

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        """Return the angle of wrist 2 from the nearest half turn."""
        return asin(abs(sin(joints_rad[4])))

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        """Return the angle of wrist 1."""
        return joints_rad[3]

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        arm = self.dimensions
        q1, q2, q3, q4, _, _ = joints_rad
        c1, s1 = cos(q1), sin(q1)
        q23 = q2 + q3
        elbow_u, elbow_up = arm.a2_mm * cos(q2), arm.d1_mm + arm.a2_mm * sin(q2)
        wrist_u, wrist_up = elbow_u + arm.a3_mm * cos(q23), elbow_up + arm.a3_mm * sin(q23)
        last_u, last_up = wrist_u + arm.d5_mm * sin(q23 + q4), wrist_up - arm.d5_mm * cos(q23 + q4)
        upper_x, upper_y = s1 * arm.upper_arm_aside_mm, -c1 * arm.upper_arm_aside_mm
        fore_x, fore_y = s1 * arm.forearm_aside_mm, -c1 * arm.forearm_aside_mm
        hand_x, hand_y = s1 * arm.d4_mm, -c1 * arm.d4_mm
        shoulder = (upper_x, upper_y, arm.d1_mm)
        elbow_x, elbow_y = c1 * elbow_u, s1 * elbow_u
        elbow_outside = (elbow_x + upper_x, elbow_y + upper_y, elbow_up)
        elbow_inside = (elbow_x + fore_x, elbow_y + fore_y, elbow_up)
        wrist_x, wrist_y = c1 * wrist_u, s1 * wrist_u
        wrist_1 = (wrist_x + fore_x, wrist_y + fore_y, wrist_up)
        wrist_2 = (wrist_x + hand_x, wrist_y + hand_y, wrist_up)
        wrist_3 = (c1 * last_u + hand_x, s1 * last_u + hand_y, last_up)
        flange = self.forward(joints_rad)
        return [
            ((0.0, 0.0, arm.d1_mm), shoulder),
            (shoulder, elbow_outside),
            (elbow_outside, elbow_inside),
            (elbow_inside, wrist_1),
            (wrist_1, wrist_2),
            (wrist_2, wrist_3),
            (wrist_3, flange.position_mm),
        ], flange

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        arm = self.dimensions
        about_wrist_3 = max((hypot(x, y) for x, y, _ in tool_points_mm), default=0.0)
        beyond = max((hypot(x, y, z + arm.d6_mm) for x, y, z in tool_points_mm), default=0.0)
        about_wrist_2 = max(beyond, arm.d6_mm)
        about_wrist_1 = about_wrist_2 + arm.d5_mm
        about_elbow = about_wrist_1 + abs(arm.a3_mm)
        about_shoulder = about_elbow + abs(arm.a2_mm)
        about_base = hypot(about_shoulder, max(arm.upper_arm_aside_mm, arm.d4_mm + about_wrist_2))
        return (about_base, about_shoulder, about_elbow, about_wrist_1, about_wrist_2, about_wrist_3)


def chain_jacobian(links: Sequence[Pose], joints_rad: JointVector) -> NDArray[np.float64]:
    """Return the geometric Jacobian (6, 6) of the chain Rz(q1) L1 .. Rz(q6) L6 at its end, in its base."""
    import numpy as np  # for planning only: the real-time process goes without

    frames, flange = chain_frames(links, joints_rad)
    end = flange.position_mm
    result = np.empty((6, 6))
    for column, frame in enumerate(frames):
        a, b, c = frame.rotation[2::3]
        x, y, z = (e - o for e, o in zip(end, frame.position_mm, strict=True))
        result[:, column] = (b * z - c * y, c * x - a * z, a * y - b * x, a, b, c)
    return result


def chain_frames(links: Sequence[Pose], joints_rad: Sequence[float]) -> tuple[list[Pose], Pose]:
    """Return the frame that turns with each joint, and the end of the chain Rz(q1) L1 .. Rz(q6) L6."""
    frames, place = [], Pose()
    for link, q in zip(links, joints_rad, strict=True):
        c, s, r = cos(q), sin(q), place.rotation
        turned = (
            r[0] * c + r[1] * s,
            r[1] * c - r[0] * s,
            r[2],
            r[3] * c + r[4] * s,
            r[4] * c - r[3] * s,
            r[5],
            r[6] * c + r[7] * s,
            r[7] * c - r[6] * s,
            r[8],
        )
        frame = Pose(place.position_mm, turned)
        frames.append(frame)
        place = frame.compose(link)
    return frames, place


def _chain(arm: Dimensions) -> Chain:
    return Chain(
        base_mm=(0.0, 0.0, arm.d1_mm),
        joints=(
            Joint(Z, ORIGIN),
            Joint(MINUS_Y, (arm.a2_mm, 0.0, 0.0)),
            Joint(MINUS_Y, (arm.a3_mm, 0.0, 0.0)),
            Joint(MINUS_Y, (0.0, -arm.d4_mm, 0.0)),
            Joint(MINUS_Z, (0.0, 0.0, -arm.d5_mm)),
            Joint(MINUS_Y, (0.0, -arm.d6_mm, 0.0)),
        ),
        flange_rotation=(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
    )


def _links(arm: Dimensions) -> tuple[Link, ...]:
    """Build the links: housings of shoulder and elbow across the tubes, tubes, wrists, hand to the flange."""
    upper, fore = -arm.upper_arm_aside_mm, -arm.forearm_aside_mm

    def across(y_mm: float, x_mm: float = 0.0) -> Vector3:
        return (x_mm, y_mm, 0.0)

    a2, a3, d4 = arm.a2_mm, arm.a3_mm, -arm.d4_mm
    return (
        Link(SHOULDER, ArmPart.UPPER_ARM, 0, ORIGIN, across(upper), (COLUMN_NAME,)),
        Link(UPPER_ARM, ArmPart.UPPER_ARM, 1, across(upper), across(upper, a2), (COLUMN_NAME, SHOULDER)),
        Link(ELBOW, ArmPart.UPPER_ARM, 1, across(upper, a2), across(fore, a2), (UPPER_ARM,)),
        Link(FOREARM, ArmPart.FOREARM, 2, across(fore), across(fore, a3), (UPPER_ARM, ELBOW)),
        Link(WRIST_1, ArmPart.WRIST, 3, across(fore), across(d4), (FOREARM,)),
        Link(WRIST_2, ArmPart.WRIST, 4, ORIGIN, (0.0, 0.0, -arm.d5_mm), (FOREARM, WRIST_1)),
        Link(HAND, ArmPart.HAND, 5, ORIGIN, (0.0, -arm.d6_mm, 0.0), (WRIST_1, WRIST_2)),
    )


_ARMS = {name: UniversalRobot(dimensions) for name, dimensions in DIMENSIONS.items()}


def universal_robot(model: str) -> UniversalRobot:
    """Return the nominal arm of a model; raises KeyError for an unknown name."""
    return _ARMS[model]
