"""An arm's chain of joints, and the bodies of its links: what clearance and calibration need of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol

from ronna_hw.arm.pose import Pose, Rotation9
from ronna_hw.devices.readings import JointVector, Vector3

Segment = tuple[Vector3, Vector3]


class ArmPart(StrEnum):
    """The parts of an arm whose thickness a theatre file states (`[cell.arm]`)."""

    COLUMN = "column"
    UPPER_ARM = "upper_arm"
    FOREARM = "forearm"
    WRIST = "wrist"
    HAND = "hand"


class Joint(NamedTuple):
    """One joint of a chain. With all joints at zero every frame is parallel to the base.

    `axis` is a unit vector, about which angles are positive; `to_next_mm` leads to the next joint, or from
    the last joint to the flange, in the frame that turns with this one.
    """

    axis: Vector3
    to_next_mm: Vector3


class Chain(NamedTuple):
    """The nominal chain from the robot base through the joints to the flange.

    `flange_rotation` rotates the frame of the last link into that of the flange.
    """

    base_mm: Vector3  # of the first joint
    joints: tuple[Joint, ...]
    flange_rotation: Rotation9


class Link(NamedTuple):
    """The body of a link: a capsule in the frame that turns with joint `joint`, counted from 0.

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
    """Positions of an arm's bodies. A tool is mounted on the flange and touches the last link only."""

    @property
    def chain(self) -> Chain:
        """The nominal chain; planning multiplies it out."""
        ...

    @property
    def links(self) -> tuple[Link, ...]:
        """The moving bodies, from the base outwards."""
        ...

    @property
    def column_height_mm(self) -> float:
        """Height of the first moving body's axis above the base: the fixed column ends below it."""
        ...

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        """Axes of all links in the robot base, and the flange's pose: the live monitor's own closed form.

        Called in the real-time loop; shares no formula with the sweeps that multiply out `chain`.
        """
        ...

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        """Bound on the motion of any point of links or tool (flange frame), per radian of each joint."""
        ...
