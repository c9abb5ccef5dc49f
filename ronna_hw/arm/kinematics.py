"""Vendor-neutral interface to an arm (chain, bodies, kinematics) of any axis order, with any wrist."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from math import hypot
from typing import TYPE_CHECKING, NamedTuple, NewType, Protocol

from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.pose import Pose, Rotation9
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

Segment = tuple[Vector3, Vector3]
NEAR_BASE_MM = 10.0  # no arm reaches in there; a reach in metres would be less
METRES_ADVICE = "Positions are in mm; were these metres?"


def require_off_base(target: Pose) -> None:
    """Raise ARM-001 for a target at the centre of the base, where one in metres seems to be."""
    if (distance_mm := hypot(*target.position_mm)) < NEAR_BASE_MM:
        x, y, z = target.position_mm
        raise Unreachable(
            f"the target at x {x:g} mm, y {y:g} mm, z {z:g} mm is inside the base",
            limit=f"{NEAR_BASE_MM:g} mm from its centre",
            got=f"{distance_mm:.2g} mm",
            action=METRES_ADVICE,
        )


class ArmPart(StrEnum):
    """Arm parts whose thickness is set in the theatre file (`[cell.arm]`)."""

    COLUMN = "column"
    UPPER_ARM = "upper_arm"
    FOREARM = "forearm"
    WRIST = "wrist"
    HAND = "hand"


class ArmRadii(NamedTuple):
    """Capsule radii of an arm's bodies, by part."""

    column_mm: float
    upper_arm_mm: float
    forearm_mm: float
    wrist_mm: float
    hand_mm: float

    def of(self, part: ArmPart) -> float:
        """Return the radius of a part, mm."""
        return self[PARTS.index(part)]


PARTS = (ArmPart.COLUMN, ArmPart.UPPER_ARM, ArmPart.FOREARM, ArmPart.WRIST, ArmPart.HAND)


class Joint(NamedTuple):
    """Joint of a kinematic chain. With all joints at zero, every frame is parallel to the base.

    `axis` is a unit vector, about which angles are positive; `to_next_mm` leads to the next joint, or from
    the last joint to the flange, in the frame that turns with this one.
    """

    axis: Vector3
    to_next_mm: Vector3


class Chain(NamedTuple):
    """Nominal kinematic chain from the robot base to the flange.

    `flange_rotation` rotates the frame of the last link into that of the flange.
    """

    base_mm: Vector3  # of the first joint
    joints: tuple[Joint, ...]
    flange_rotation: Rotation9


class Link(NamedTuple):
    """Collision body of a link: a capsule in the frame that rotates with joint `joint`, counted from 0.

    `touches` names the preceding bodies, possibly `COLUMN_NAME`, that it touches by construction.
    """

    name: str
    part: ArmPart
    joint: int
    start_mm: Vector3
    end_mm: Vector3
    touches: tuple[str, ...]


COLUMN_NAME = "base column"


class ArmBodies(Protocol):
    """Positions of an arm's collision bodies. A flange-mounted tool is in contact with the last link only."""

    @property
    def chain(self) -> Chain:
        """Nominal chain from base to flange."""

    @property
    def links(self) -> tuple[Link, ...]:
        """Moving bodies, from the base outwards."""

    @property
    def radii(self) -> ArmRadii:
        """Radii of the bodies, unless the theatre file gives its own."""

    @property
    def column_height_mm(self) -> float:
        """Height of the axis of the first moving body above the base, mm; the fixed column ends below it."""

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        """Return the axes of all links in the robot base, and the pose of the flange.

        The live monitor's own closed form, called in the real-time loop; shares no formula with the sweeps
        that multiply out `chain`.
        """

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        """Return upper bounds on the motion of any link or tool point, in mm per radian of each joint."""


Branch = NewType("Branch", int)
"""An inverse configuration. Opaque outside the arm it belongs to; records store the number."""

RANGE_SLACK_RAD = 1e-9  # rounding at the end of a range is no violation


class Solution(NamedTuple):
    """Inverse-kinematics solution: joint angles and their branch."""

    branch: Branch
    joints_rad: JointVector


class SingularMeasure(NamedTuple):
    """Normalized distances from the three kinds of singularity, each from 0 (singular) to 1.

    `wrist`: two wrist axes aligned; `elbow`: upper arm and forearm aligned; `shoulder`: the
    wrist on the first axis.
    """

    wrist: float
    elbow: float
    shoulder: float

    @property
    def least(self) -> float:
        """Smallest of the three distances."""
        return min(self)


class JointRanges(Protocol):
    """Joint ranges and capabilities of an arm, one value per joint from the base outwards."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Joint names for messages."""

    @property
    def lower_rad(self) -> JointVector: ...

    @property
    def upper_rad(self) -> JointVector: ...

    @property
    def full_speed_rad_s(self) -> JointVector: ...

    @property
    def acceleration_rad_s2(self) -> JointVector: ...


class Kinematics(JointRanges, ArmBodies, Protocol):
    """Nominal kinematics of an arm: forward, ROBOT <- FLANGE, and inverse."""

    def __hash__(self) -> int:
        """Return a hash; an arm's geometry never changes, so results may be kept by it."""

    @property
    def name(self) -> str:
        """Arm name, as used in calibration records."""

    @property
    def home_rad(self) -> JointVector:
        """Home posture: clear of singularities, tool pointing down in front of the wrist."""

    @property
    def branches(self) -> tuple[Branch, ...]:
        """All branches, most common first."""

    def forward(self, joints_rad: JointVector) -> Pose:
        """Return the flange pose in the robot base, as plain floats."""

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        """Return the flange pose as a checked transform, ROBOT <- FLANGE."""

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        """Return the geometric Jacobian of the flange in the base, (6, n): mm and rad per rad."""

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        """Return all joint vectors within range that reach the flange pose, including whole turns.

        Raises ARM-001 when the pose is out of reach, ARM-002 when a joint is undefined in a branch within the
        ranges, ARM-003 when every branch leaves the ranges.
        """

    def branch_of(self, joints_rad: JointVector) -> Branch:
        """Return the branch of a joint vector."""

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        """Return the solution in a given branch, unwrapped to be nearest `near`. Real-time safe.

        Raises ARM-001, ARM-002 or ARM-003 like `solutions`, for this branch alone.
        """

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        """Return the distance of a posture from each kind of singularity."""

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        """Return the wrist's bend away from its singularity, as a non-negative angle."""

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        """Return the angle of the joint that rotates the bent wrist as a whole."""
