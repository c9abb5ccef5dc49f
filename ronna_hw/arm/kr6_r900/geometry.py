"""Dimensions, joint ranges and capabilities of the two KR 6 R900 variants."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from ronna_hw.arm.kinematics import ArmRadii
from ronna_hw.arm.pose import radians6
from ronna_hw.vectors import JointVector

SIXX, R900_2 = "kr6_r900_sixx", "kr6_r900_2"  # the two differ by 10 mm at the elbow and at the flange


@dataclass(frozen=True)
class Kr6Dimensions:
    """Dimensions of a variant; names follow the chain from $ROBROOT to the flange.

    A1 turns about -z, A2, A3, A5 about +y, A4, A6 about -x. With all axes at zero the arm extends along x.
    """

    name: str
    base_height_mm: float  # $ROBROOT to A2, along z
    shoulder_offset_mm: float  # A1 to A2, along x
    upper_arm_mm: float  # A2 to A3
    elbow_offset_mm: float  # A3 to the axis of A4, perpendicular
    forearm_mm: float  # A3 to the wrist centre, along A4
    flange_mm: float  # wrist centre to flange, along A6
    lower_rad: JointVector
    upper_rad: JointVector
    full_speed_rad_s: JointVector
    acceleration_rad_s2: JointVector

    @cached_property
    def elbow_to_wrist_mm(self) -> float:
        """Straight-line distance from A3 to the wrist centre, mm."""
        return math.hypot(self.forearm_mm, self.elbow_offset_mm)

    @cached_property
    def stretched_A3_rad(self) -> float:
        """Angle of A3 at which upper arm and wrist centre are aligned."""
        return math.atan2(self.elbow_offset_mm, self.forearm_mm)

    @cached_property
    def reach_mm(self) -> float:
        """Largest distance of the wrist centre from the A1 axis at the height of A2, mm."""
        return self.shoulder_offset_mm + self.upper_arm_mm + self.elbow_to_wrist_mm

    def wrist_ahead_mm(self, A2: float, A3: float) -> float:
        """Signed distance of the wrist centre from the axis of A1, mm; negative overhead."""
        return (
            self.shoulder_offset_mm
            + self.upper_arm_mm * math.cos(A2)
            + self.elbow_to_wrist_mm * math.cos(A2 + A3 - self.stretched_A3_rad)
        )


# Geometry and ranges: public robot descriptions of both arms. Accelerations: planner limits published for the
# sixx; none are published for the -2, which is no weaker, so the same are used.
_SIXX = Kr6Dimensions(
    name=SIXX,
    base_height_mm=400.0,
    shoulder_offset_mm=25.0,
    upper_arm_mm=455.0,
    elbow_offset_mm=35.0,
    forearm_mm=420.0,
    flange_mm=80.0,
    lower_rad=radians6(-170, -190, -120, -185, -120, -350),
    upper_rad=radians6(170, 45, 156, 185, 120, 350),
    full_speed_rad_s=radians6(360, 300, 360, 381, 388, 615),
    acceleration_rad_s2=(21.67, 6.89, 31.42, 133.1, 135.6, 268.4),
)
_R900_2 = replace(
    _SIXX,
    name=R900_2,
    elbow_offset_mm=25.0,
    flange_mm=90.0,
    full_speed_rad_s=radians6(360, 300, 360, 450, 450, 540),
)
DIMENSIONS = {SIXX: _SIXX, R900_2: _R900_2}

# Our own conservative estimates (U).
RADII = ArmRadii(column_mm=150.0, upper_arm_mm=85.0, forearm_mm=70.0, wrist_mm=45.0, hand_mm=45.0)
