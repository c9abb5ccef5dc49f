"""Tool records for the arm: table `[tools.NAME]` of the theatre file.

A record states identity, purpose and clearance bodies of a tool. Its tip position is in a separate
calibration record that it refers to.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Annotated, ClassVar, Self

from pydantic import Field, field_validator, model_validator

from ronna_hw.calibration import STEREO_HEAD_NUMBER, Dated, MountPose, Numbers3, Numbers4, PoseRecord, Strict
from ronna_hw.collision_config import ToolBody
from ronna_hw.plausible import (
    FARTHEST_ON_TOOL_MM,
    LONGEST_TRAVEL_MM,
    SHORTEST_TRANSLATION_MM,
    BoreLength,
    DialReading,
    JointDegrees,
    Length,
    Words,
    are_degrees,
    farther_than,
)

Angles6 = tuple[JointDegrees, JointDegrees, JointDegrees, JointDegrees, JointDegrees, JointDegrees]


class ToolPurpose(StrEnum):
    """Purpose of a tool."""

    STEREO_HEAD = "stereo_head"
    NEEDLE_GUIDE = "needle_guide"
    DRILL_GUIDE = "drill_guide"
    DRILL = "drill"
    GRIPPER = "gripper"
    POINTER = "pointer"


GUIDES = (ToolPurpose.NEEDLE_GUIDE, ToolPurpose.DRILL_GUIDE)
WITH_TIP = (*GUIDES, ToolPurpose.DRILL, ToolPurpose.POINTER)
# A record compares each later mounting with the mean of so many approaches to the gauge, the tool seated anew
# for each mounting: read once, its own seat and arrival would have every sixth good guide refused.
GAUGE_MOUNTINGS, GAUGE_APPROACHES = 3, 12


class GuideBore(Strict):
    """Bore of a guide, along the axis of its tip frame.

    The tip frame is that of the mandrel with which the tip was calibrated: its end, beyond the guide's.
    """

    reach_mm: Annotated[float, Field(gt=0, le=500), Length] = Field(
        description="Distance from the lower end of the guide to the end of the mandrel."
    )
    length_mm: Annotated[float, Field(gt=0, le=500), BoreLength] = Field(
        description="Length from the upper end, on which a depth stop rests, to the lower end."
    )
    play_mm: Annotated[float, Field(ge=0, le=2.0)] = Field(
        description="Diameter of the bore minus that of the instrument."
    )


class Gauge(Strict):
    """Reference pose for checking a tool, with the table gauge readings from when it was measured."""

    joints_deg: Angles6 = Field(description="Joint angles of the arm with the mandrel in the gauge.")
    reading_mm: tuple[DialReading, DialReading, DialReading] = Field(
        default=(0.0, 0.0, 0.0),
        description="Mean readings of the dials at the end, along x, y and z of the tool.",
    )
    upper_reading_mm: tuple[DialReading, DialReading] = Field(
        default=(0.0, 0.0), description="Mean readings of the dials higher up on the mandrel, along x and y."
    )
    approaches: Annotated[int, Field(ge=1)] = Field(
        default=1, description="Number of approaches that they are the mean of."
    )
    spread_mm: Annotated[float, Field(ge=0)] = Field(
        default=0.0, description="Standard deviation of one of their readings."
    )
    base_mm: Annotated[float, Field(gt=0, le=500), Length] = Field(
        default=60.0, description="Distance between both dial heights."
    )
    travel_mm: Annotated[float, Field(gt=0, le=LONGEST_TRAVEL_MM), Length] = Field(
        default=10.0,
        description="Travel of a dial, to either side; a reading beyond it is taken as a typing error.",
    )

    @field_validator("joints_deg")
    @classmethod
    def _require_degrees(cls, joints_deg: Angles6) -> Angles6:
        if not are_degrees(joints_deg):  # the arm would go there, stretched out
            listed = " ".join(f"{angle:g}" for angle in joints_deg)
            raise ValueError(f"are {listed}, all within 2 pi: give degrees, not radians")
        return joints_deg

    @property
    def plausible_mm(self) -> tuple[float, float]:
        """Plausible range of dial readings, mm."""
        recorded_mm = (*self.reading_mm, *self.upper_reading_mm)
        return min(recorded_mm) - self.travel_mm, max(recorded_mm) + self.travel_mm


class ToolFrame(Strict):
    """Frame of spheres mounted on the tool, for identification by the tracker."""

    tool: Words = Field(description="Name of the frame among the tracker's tools.")
    mount_from_frame: MountPose = Field(description="Pose of the frame in that on the arm's mount.")


class TipInHead(Strict):
    """Tool-tip pose in the stereo-head frame, unaffected by head and arm calibrations."""

    translation_mm: Numbers3 = Field(description="Position of the tip.")
    quaternion_wxyz: Numbers4 = Field(description="Rotation as a unit quaternion, scalar first.")

    @classmethod
    def of(cls, flange_from_head: PoseRecord, flange_from_tip: PoseRecord) -> Self:
        """Compute the pose from both records of the theatre file."""
        from ronna_hw.arm.pose import Pose  # a theatre computes this as it starts: SciPy would double that

        head, tip = (
            Pose.from_quaternion(record.translation_mm, record.quaternion_wxyz)
            for record in (flange_from_head, flange_from_tip)
        )
        here = head.inverse().compose(tip)
        return cls(translation_mm=here.position_mm, quaternion_wxyz=here.quaternion())

    def off(self, other: TipInHead) -> tuple[float, float]:
        """Return the deviation of another pose from this one, mm and rad."""
        ours, theirs = self.quaternion_wxyz, other.quaternion_wxyz  # q and -q are one rotation
        chord = min(math.dist(ours, theirs), math.dist(ours, [-number for number in theirs]))
        turned_rad = 4.0 * math.asin(min(1.0, chord / 2.0))
        return math.dist(self.translation_mm, other.translation_mm), turned_rad


class ToolRecord(Dated):
    """Tool record: identity, purpose, mass, clearance bodies, and tip or bore."""

    what: ClassVar[str] = "tool record"

    purpose: Annotated[ToolPurpose, Field(strict=False)] = Field(description="Purpose of the tool.")
    number: Annotated[int, Field(ge=1, le=16)] = Field(
        description="Tool number reported by the controller's inputs; "
        f"{STEREO_HEAD_NUMBER} is that of the stereo head."
    )
    flange: Words = Field(
        description="Name of the flange, or of the changer on it, on which it was measured."
    )
    mass_kg: Annotated[float, Field(gt=0, le=10)] = Field(description="Mass of everything below the changer.")
    centre_of_gravity_mm: Annotated[Numbers3, farther_than(SHORTEST_TRANSLATION_MM, FARTHEST_ON_TOOL_MM)] = (
        Field(description="Centre of gravity in the flange frame.")
    )
    bodies: tuple[ToolBody, ...] = Field(
        default=(), description="Bodies for clearance checks, in the tip frame; default: those of `[cell]`."
    )
    tip: str | None = Field(default=None, description="Identifier of the calibration record of the tip.")
    tip_in_head: TipInHead | None = Field(
        default=None,
        description="Where that record has the tip, in the frame of the stereo head, as the gauge was read.",
    )
    bore: GuideBore | None = Field(default=None, description="Bore, for a guide.")
    gauge: Gauge | None = Field(default=None, description="Check after mounting.")
    frame: ToolFrame | None = Field(
        default=None, description="Frame of spheres on the tool for the tracker, if it has one."
    )

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.purpose in WITH_TIP and not self.tip:
            raise ValueError(f"a {self.purpose.value} needs `tip`, the identifier of its tip's calibration")
        if self.purpose in GUIDES and self.bore is None:
            raise ValueError(f"a {self.purpose.value} needs `bore`")
        if self.purpose in GUIDES and self.gauge is None:
            raise ValueError(f"a {self.purpose.value} needs `gauge`: where it is checked after mounting")
        if self.bore is not None and self.gauge is not None and self.bore.reach_mm < self.gauge.base_mm:
            raise ValueError(
                f"bore.reach_mm is {self.bore.reach_mm:g}: expected at least gauge.base_mm = "
                f"{self.gauge.base_mm:g}, where the upper dials touch the mandrel; give millimetres"
            )
        if self.number == STEREO_HEAD_NUMBER and self.purpose is not ToolPurpose.STEREO_HEAD:
            raise ValueError(
                f"a {self.purpose.value} has number {self.number}, that of the stereo head: expected another"
            )
        return self

    @property
    def _renewing(self) -> str:
        how = "Measure this tool again with ronna-tool define"
        if self.gauge is not None:
            how = "Read the gauge with this tool, then run ronna-tool renew"
        return f"{how}; no motion until then."
