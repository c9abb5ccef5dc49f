"""Scene model parts: value ranges, planned trajectory, guide and manual accuracy.

The frame of spheres on the guide is how the tracker identifies the mounted guide and measures its pose.
"""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ronna_hw import plausible
from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from ronna_hw.plausible import FreeAngle, Margin, TrajectoryName
from ronna_hw.wire.gige_vision import TEXT_BYTES, Bootstrap
from ronna_hw.wire.polaris_rom import PART_NUMBER_BYTES, ROM_MARKERS, ROM_MINIMUM_MARKERS

UNIT_TOLERANCE = 1e-3  # for the length of a unit vector

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
# A camera's register is 0-terminated: a longer number would be truncated.
Serial = Annotated[
    str, Field(min_length=1, max_length=TEXT_BYTES[Bootstrap.SERIAL_NUMBER] - 1, pattern=r"^[!-~]+$")
]
# The theatre writes the definition into a file of this name, and fault scripts name the tool by it.
ToolName = Annotated[
    str, Field(min_length=1, max_length=plausible.LONGEST_NAME, pattern=plausible.NAME_PATTERN)
]
# A definition holds ASCII: a longer number would be truncated, and the tool not found by it.
PartNumber = Annotated[str, Field(min_length=1, max_length=PART_NUMBER_BYTES, pattern=r"^[ -~]+$")]


def _require_marker_count(markers_mm: tuple[Numbers3, ...]) -> tuple[Numbers3, ...]:
    # No length constraint on the field: its message would suspect a decimal comma.
    if not ROM_MINIMUM_MARKERS <= len(markers_mm) <= ROM_MARKERS:
        raise ValueError(
            f"a tool definition has {ROM_MINIMUM_MARKERS} to {ROM_MARKERS} markers, got {len(markers_mm)}"
        )
    return markers_mm


def _require_unit(direction: Numbers3) -> Numbers3:
    if abs((length := math.hypot(*direction)) - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"has length {length:.3g}, expected a unit vector")
    return direction


OnTool = Annotated[Numbers3, plausible.farther_than(plausible.SHORTEST_MM, plausible.FARTHEST_ON_TOOL_MM)]
MarkerCentres = Annotated[tuple[OnTool, ...], AfterValidator(_require_marker_count)]
Facing = Annotated[Numbers3, AfterValidator(_require_unit)]


class Target(Strict):
    """A planned trajectory in the CT frame."""

    identifier: TrajectoryName = Field(description="Name of the trajectory.")
    entry_ct_mm: Numbers3 = Field(description="Entry point, CT frame.")
    target_ct_mm: Numbers3 = Field(description="Target point, CT frame.")
    free_angle_deg: FreeAngle = Field(default=0.0, description="Rotation of the guide about the trajectory.")
    margin_mm: Margin = Field(default=2.0, description="Margin stated in the plan.")

    @model_validator(mode="after")
    def _has_a_depth(self) -> Self:
        if not plausible.LEAST_DEPTH_MM <= self.depth_mm <= plausible.MOST_DEPTH_MM:
            raise ValueError(
                f"entry_ct_mm and target_ct_mm are {self.depth_mm:.3g} mm apart, "
                f"expected {plausible.LEAST_DEPTH_MM:g} to {plausible.MOST_DEPTH_MM:g} mm"
            )
        return self

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target in mm."""
        return math.dist(self.entry_ct_mm, self.target_ct_mm)

    @property
    def outwards_ct(self) -> Numbers3:
        """Unit vector from the target towards the entry."""
        x, y, z = ((e - t) / self.depth_mm for e, t in zip(self.entry_ct_mm, self.target_ct_mm, strict=True))
        return (x, y, z)


class Guide(Strict):
    """True guide and instrument, as opposed to their records.

    Its tip frame is that of the mandrel with which the tip was calibrated; z points down the bore.
    """

    reach_mm: Positive = Field(
        default=85.0, description="Length of the mandrel beyond the guide's lower end."
    )
    bore_mm: Positive = Field(
        default=85.0, description="Length of the guide from its upper to its lower end."
    )
    play_mm: NotNegative = Field(
        default=0.04, description="Diameter of the bore minus that of the instrument."
    )
    depth_stop_mm: NotNegative = Field(
        default=0.03, description="Error of a depth stop set by hand, one standard deviation."
    )
    seat_mm: NotNegative = Field(
        default=0.008, description="Repeatability of the changer, per axis, one standard deviation."
    )
    bent_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="Offset of the mandrel's end from its nominal position."
    )
    tilt_deg: tuple[float, float] = Field(
        default=(0.0, 0.0),
        description="Tilt of the bore from its nominal direction, about x and y of the tip frame.",
    )
    mass_kg: Positive = Field(default=1.4, description="Mass of everything below the changer.")
    tip_from_frame: PoseRecord | None = Field(
        default=None,
        description="Pose of the spheres on the guide (tracker tool `guide_frame`); without it, none.",
    )


class ManualAccuracy(Strict):
    """Accuracy of the staff's manual work."""

    gauge_mm: NotNegative = Field(
        default=0.005, description="Error of a dial reading on the gauge, one standard deviation."
    )


STEREO_HEAD_KG = 2.1
CENTRE_OF_GRAVITY_MM = (110.0, 0.0, 30.0)  # both tools with the common mount, flange frame
GUIDE_FRAME_NAME = "guide_frame"
GUIDE_FRAME_PART_NUMBER = "RONNA-G"
# The six distances differ by more than 5 mm from each other and by more than 2 mm from those of other frames.
GUIDE_FRAME_MARKERS_MM = ((-49.0, -40.0, 0.0), (-18.0, -6.0, 0.0), (-34.0, 31.0, 0.0), (32.0, 18.0, 0.0))
# Above the upper end of the bore, beside the mount; it faces up, as M does.
GUIDE_FRAME_IN_TIP = PoseRecord(translation_mm=(-90.0, 0.0, -215.0), quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))

ASSISTANT_FRAME_NAME = "assistant_frame"
ASSISTANT_FRAME_PART_NUMBER = "RONNA-A"
# The six distances differ by 5 mm from each other and by 2 mm from those of other frames. No three markers
# are near a line: any three that are seen show the orientation.
ASSISTANT_FRAME_MARKERS_MM = ((-39.0, -84.0, 0.0), (56.0, 15.0, 0.0), (-46.0, 3.0, 0.0), (28.0, 66.0, 0.0))
