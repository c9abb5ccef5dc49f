"""Arms of the drawn scenes: where each of them works, and the sizes of its errors.

Sizes are one standard deviation. Those of the KR 6 R900 are parameter set S. It is no measurement: its sizes
were chosen so that the means of the thesis' table 4, measured on one robot, come out.
"""

from __future__ import annotations

from math import radians
from typing import NamedTuple

from ronna_hw.arm.catalogue import ArmChoice
from sim.world.rigid import Point
from sim.world.scene.model import Numbers6


class ErrorSizes(NamedTuple):
    """Sizes of an arm's errors, one standard deviation each; backlash and sag are every arm's own."""

    link_translation_mm: float  # per axis
    link_rotation_rad: float  # per axis
    joint_offset_rad: float
    harmonic_1_rad: float
    harmonic_2_rad: float
    backlash_rad: float
    sag_rad: float
    repeatability_mm: float  # per axis


class ArmDesign(NamedTuple):
    """Start of an arm, the place of the patient in front of it, and the sizes of its errors."""

    variant: str
    choice: ArmChoice | None  # None: no scene is drawn with it
    home_deg: Numbers6  # flange down, stereo head forward: above the head, clear of every singularity
    head_mm: Point  # middle of the places of the head's centre, robot frame: clear of singularities
    errors: ErrorSizes
    # Of an assistant: the flange down, drawn back from the patient, where the master turns its frame, and in
    # a place where the master at home does not hide the assistant's frame.
    assistant_home_deg: Numbers6


SET_S = ErrorSizes(
    link_translation_mm=0.40,
    link_rotation_rad=radians(0.05),
    joint_offset_rad=radians(0.05),
    harmonic_1_rad=radians(0.015),
    harmonic_2_rad=radians(0.008),
    backlash_rad=radians(0.02),
    sag_rad=radians(0.03),
    repeatability_mm=0.015,
)
# Before the factory's calibration, which its controller knows: that identifies most of links and offsets (U).
# The vendor publishes the repeatability alone, 0.03 mm, of which half is taken per axis, as for the other
# arm (U). Its strain wave gears have next to no backlash.
UR5E_ERRORS = ErrorSizes(
    link_translation_mm=0.20,
    link_rotation_rad=radians(0.03),
    joint_offset_rad=radians(0.03),
    harmonic_1_rad=radians(0.015),
    harmonic_2_rad=radians(0.008),
    backlash_rad=radians(0.01),
    sag_rad=radians(0.03),
    repeatability_mm=0.015,
)
# 0.1 mm of repeatability by ISO 9283: a mean and three standard deviations of the distance.
UR5_ERRORS = UR5E_ERRORS._replace(
    link_translation_mm=0.30,
    link_rotation_rad=radians(0.04),
    joint_offset_rad=radians(0.04),
    repeatability_mm=0.028,
)

KR6 = ArmDesign(
    variant="kr6_r900_sixx",
    choice=ArmChoice.KR6,
    home_deg=(0.0, -75.0, 99.0, 0.0, 66.0, 180.0),
    head_mm=(760.0, 0.0, 200.0),
    errors=SET_S,
    assistant_home_deg=(-32.0, -120.0, 145.0, 0.0, 65.0, 0.0),
)
_UR5E = ArmDesign(
    variant="ur5e",
    choice=ArmChoice.UR5E,
    home_deg=(0.0, -90.0, -90.0, -90.0, 90.0, -90.0),  # elbow up, forearm level
    head_mm=(710.0, -133.0, 70.0),
    errors=UR5E_ERRORS,
    assistant_home_deg=(77.0, -39.0, -119.0, -112.0, 90.0, 134.0),
)
DESIGNS = {
    design.variant: design
    for design in (
        KR6,
        KR6._replace(variant="kr6_r900_2", choice=None),
        _UR5E._replace(variant="ur5", choice=ArmChoice.UR5, head_mm=(700.0, -109.0, 30.0), errors=UR5_ERRORS),
        _UR5E,
        *(_UR5E._replace(variant=size, choice=None) for size in ("ur3e", "ur10e", "ur16e")),
    )
}
CHOSEN = {design.choice: design for design in DESIGNS.values() if design.choice is not None}
