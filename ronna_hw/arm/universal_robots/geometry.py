"""Dimensions, joint ranges and capabilities of the arms of Universal Robots."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

from ronna_hw.arm.kinematics import ArmRadii
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.vectors import JointVector

ALPHA_RAD: JointVector = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
_WHOLE_TURN = radians6(360, 360, 360, 360, 360, 360)
FULL_SPEED_RAD_S = radians6(180, 180, 180, 180, 180, 180)
FAST_WRIST_RAD_S = radians6(180, 180, 180, 360, 360, 360)
HEAVY_BASE_RAD_S = radians6(120, 120, 180, 180, 180, 180)

# The vendor publishes no accelerations. These are well below what its own programs may ask for (40 rad/s2),
# and stop from full speed within the 500 ms of its category 1 (U).
ACCELERATION_RAD_S2: JointVector = (10.0, 10.0, 10.0, 20.0, 20.0, 20.0)

# The elbow turns as far as the others, but beyond half a turn upper arm and forearm change sides (U: planners
# of the field keep to this half, the vendor does not).
ELBOW_RANGE_RAD = pi


# Housings of base (149 mm across by the data sheet) and joints, tubes and wrists with some mm to spare (U).
RADII = ArmRadii(column_mm=80.0, upper_arm_mm=65.0, forearm_mm=55.0, wrist_mm=48.0, hand_mm=45.0)
# As measured on the meshes of the vendor's robot descriptions, 3 to 6 mm to spare (U): base 64 and 95 mm,
# upper arm 47 and 76, forearm at the elbow 38 and 58; wrists in proportion to those of the UR5e, 39 mm there,
# 32 and 47 here. The UR3e's hand is slimmer than is assumed.
SMALL_RADII = ArmRadii(column_mm=70.0, upper_arm_mm=52.0, forearm_mm=44.0, wrist_mm=42.0, hand_mm=45.0)
LARGE_RADII = ArmRadii(column_mm=100.0, upper_arm_mm=82.0, forearm_mm=62.0, wrist_mm=58.0, hand_mm=53.0)


@dataclass(frozen=True)
class Dimensions:
    """Dimensions of a model in standard Denavit-Hartenberg terms, and of its tubes.

    The shoulder, elbow and wrist 1 axes are parallel. `a2_mm` and `a3_mm` are negative: with all joints at
    zero the arm extends along -x.
    """

    name: str
    a2_mm: float  # shoulder to elbow
    a3_mm: float  # elbow to wrist 1
    d1_mm: float  # base to the shoulder axis, along z
    d4_mm: float  # plane of the base axis to the wrist 2 axis, along the parallel axes
    d5_mm: float  # wrist 1 axis to wrist 3 axis
    d6_mm: float  # wrist 2 axis to the flange
    upper_arm_aside_mm: float  # axis of the tube beside the plane of the base axis
    forearm_aside_mm: float
    elbow_range_rad: float = ELBOW_RANGE_RAD
    full_speed_rad_s: JointVector = FULL_SPEED_RAD_S
    radii: ArmRadii = RADII

    @cached_property
    def lower_rad(self) -> JointVector:
        """Lower ends of the joint ranges."""
        a, b, c, d, e, f = self.upper_rad
        return (-a, -b, -c, -d, -e, -f)

    @cached_property
    def upper_rad(self) -> JointVector:
        """Upper ends of the joint ranges."""
        a, b, _, d, e, f = _WHOLE_TURN
        return (a, b, self.elbow_range_rad, d, e, f)

    @cached_property
    def reach_mm(self) -> float:
        """Largest distance of the wrist 3 axis from the base axis, in the plane of the upper arm, mm."""
        return abs(self.a2_mm) + abs(self.a3_mm) + self.d5_mm

    @cached_property
    def links(self) -> tuple[Pose, ...]:
        """Fixed part of each joint's transform Rz(q) . Tz(d) Tx(a) Rx(alpha)."""
        a = (0.0, self.a2_mm, self.a3_mm, 0.0, 0.0, 0.0)
        d = (self.d1_mm, 0.0, 0.0, self.d4_mm, self.d5_mm, self.d6_mm)
        right_angle = {pi / 2: (1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0)}
        right_angle[-pi / 2] = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0)
        return tuple(
            Pose((along, 0.0, up), right_angle.get(alpha, Pose().rotation))
            for along, up, alpha in zip(a, d, ALPHA_RAD, strict=True)
        )


UR5, UR5E = "ur5", "ur5e"  # the two differ by the shoulder's height and by the wrist's offsets
UR3E, UR10E, UR16E = "ur3e", "ur10e", "ur16e"  # the last two differ by the lengths of the tubes

# Geometry: the vendor's page on Denavit-Hartenberg parameters. Tubes beside the plane, and speeds: its robot
# descriptions (Universal_Robots_ROS2_Description 2.4.5, physical_parameters.yaml and joint_limits.yaml).
DIMENSIONS = {
    UR5: Dimensions(
        name=UR5,
        a2_mm=-425.0,
        a3_mm=-392.25,
        d1_mm=89.159,
        d4_mm=109.15,
        d5_mm=94.65,
        d6_mm=82.3,
        upper_arm_aside_mm=135.85,
        forearm_aside_mm=16.5,
    ),
    UR5E: Dimensions(
        name=UR5E,
        a2_mm=-425.0,
        a3_mm=-392.2,
        d1_mm=162.5,
        d4_mm=133.3,
        d5_mm=99.7,
        d6_mm=99.6,
        upper_arm_aside_mm=138.0,
        forearm_aside_mm=7.0,
    ),
    UR3E: Dimensions(
        name=UR3E,
        a2_mm=-243.55,
        a3_mm=-213.2,
        d1_mm=151.85,
        d4_mm=131.05,
        d5_mm=85.35,
        d6_mm=92.1,
        upper_arm_aside_mm=120.0,
        forearm_aside_mm=27.0,
        full_speed_rad_s=FAST_WRIST_RAD_S,
        radii=SMALL_RADII,
    ),
    UR10E: Dimensions(
        name=UR10E,
        a2_mm=-612.7,
        a3_mm=-571.55,
        d1_mm=180.7,
        d4_mm=174.15,
        d5_mm=119.85,
        d6_mm=116.55,
        upper_arm_aside_mm=176.2,
        forearm_aside_mm=39.3,
        full_speed_rad_s=HEAVY_BASE_RAD_S,
        radii=LARGE_RADII,
    ),
    UR16E: Dimensions(
        name=UR16E,
        a2_mm=-478.4,
        a3_mm=-360.0,
        d1_mm=180.7,
        d4_mm=174.15,
        d5_mm=119.85,
        d6_mm=116.55,
        upper_arm_aside_mm=176.0,
        forearm_aside_mm=40.0,
        full_speed_rad_s=HEAVY_BASE_RAD_S,
        radii=LARGE_RADII,
    ),
}
