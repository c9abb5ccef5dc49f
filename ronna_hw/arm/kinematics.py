"""The neutral interface to an arm's kinematics, which assumes neither an axis order nor a spherical wrist."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, NewType, Protocol

from ronna_hw.arm.links import ArmBodies
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

Branch = NewType("Branch", int)
"""An inverse configuration. Opaque outside the arm it belongs to; records store the number."""

RANGE_SLACK_RAD = 1e-9  # rounding at the end of a range is no violation


class Solution(NamedTuple):
    """Joint angles that bring the flange to a pose, with their branch."""

    branch: Branch
    joints_rad: JointVector


class SingularMeasure(NamedTuple):
    """Distance from the three kinds of singularity, each at most 1, and 0 at the singularity.

    `wrist`: two wrist axes aligned; `elbow`: upper arm and forearm aligned; `shoulder`: the
    wrist on the first axis.
    """

    wrist: float
    elbow: float
    shoulder: float

    @property
    def least(self) -> float:
        """The smallest of the three."""
        return min(self)


class JointRanges(Protocol):
    """The capabilities of an arm's joints. Vectors have one value per joint, from the base outwards."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the joints, for messages."""
        ...

    @property
    def lower_rad(self) -> JointVector: ...

    @property
    def upper_rad(self) -> JointVector: ...

    @property
    def full_speed_rad_s(self) -> JointVector: ...

    @property
    def acceleration_rad_s2(self) -> JointVector: ...


class Kinematics(JointRanges, ArmBodies, Protocol):
    """The nominal kinematics of one arm: ROBOT <- FLANGE from joint angles, and back."""

    @property
    def name(self) -> str:
        """Identifies the arm, including in calibration records."""
        ...

    @property
    def home_rad(self) -> JointVector:
        """A posture from which to start work: clear of singularities, tool down and in front of the wrist."""
        ...

    @property
    def branches(self) -> tuple[Branch, ...]:
        """All branches, the usual ones first."""
        ...

    def forward(self, joints_rad: JointVector) -> Pose:
        """Pose of the flange in the robot base, in plain floats."""
        ...

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        """The same as a checked transform, ROBOT <- FLANGE."""
        ...

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        """Geometric Jacobian of the flange in the base, (6, n): vx vy vz in mm, wx wy wz in rad, per rad."""
        ...

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        """All joint vectors within range that reach the flange pose, whole turns included.

        Raises ARM-001 when the pose is out of reach, ARM-002 when a joint is undefined in a branch within the
        ranges, ARM-003 when every branch leaves the ranges.
        """
        ...

    def branch_of(self, joints_rad: JointVector) -> Branch:
        """The branch of a joint vector."""
        ...

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        """The solution in one branch, with the whole turns nearest to `near`; called in the real-time loop.

        Raises ARM-001, ARM-002 or ARM-003 like `solutions`, for this branch alone.
        """
        ...

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        """Distance of a posture from each kind of singularity."""
        ...

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        """Angle by which the wrist is bent away from its singularity, not negative."""
        ...

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        """Angle of the joint that turns the bent wrist as a whole."""
        ...
