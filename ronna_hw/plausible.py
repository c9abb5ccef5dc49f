"""Plausibility bounds for numbers in theatre files, plans and scenes, to catch typos and wrong units.

Each bound of a theatre file is far from anything built or measured, so that no intended value is refused. A
plan and a scene share one set of bounds: the plan of a simulated patient is made from its scene, so no scene
is accepted whose plan would be refused.
"""

from __future__ import annotations

import math
from datetime import timedelta
from typing import Annotated

from pydantic import AfterValidator, Field

SHORTEST_TRANSLATION_MM = 1.0  # of a tool, of its weight, of a camera; 300 mm in metres would be shorter
SHORTEST_MM = 0.2  # nothing described in a theatre file is shorter, unlike 150 mm given in metres
FARTHEST_MM = 10_000.0  # of anything from anything else in a room
FARTHEST_ON_TOOL_MM = 1000.0  # from the flange: more than the arm itself reaches
# Of clamp and ball of a holder: the instrument passes beside a flange of up to 63 mm across, and the clamp is
# 14 mm thick about it. 110 mm in centimetres would be less, and so would 300 mm.
NEAREST_ON_HOLDER_MM = 35.0
SHORTEST_FOCAL_PX = 200.0  # of a lens on a camera with some hundred pixels; 50 mm would be less
LONGEST_FOCAL_PX = 1e6  # 1 m on pixels of 1 µm
WIDEST_VIEW_DEG = 75.0  # a 6 mm lens on a 2/3 inch sensor has 72; wider ones do not follow this distortion
# One standard deviation per axis of an arm that repeats to 0.02 mm (ISO 9283: mean plus three standard
# deviations), the best of this size. Nothing on the mount, nor any sphere, is placed or known better.
# Safety against a stated error that is not credible (U).
FINEST_ON_ARM_MM = 0.005
FINEST_MM = 0.001  # of a mean over many poses; coordinate measuring machines are off by more
FINEST_SCATTER_MM = 1e-4  # of any arm, from pose to pose; 0.02 mm in metres would be less
LARGEST_ARM_ERROR_MM = 1.0  # an arm of this size is off by 0.65 mm without any calibration
# Of records: each a thousand times the finest above, so that no error in micrometres passes for one in mm.
# Safety against a stated error that is not credible (U).
LARGEST_MEASURED_ERROR_MM = 1.0  # of a point, by stereo head or calibrated arm: usually 0.02 to 0.2 mm
LARGEST_MOUNTED_ERROR_MM = 5.0  # of a part on the mount; one as drawn is 2 to 4 mm off
LARGEST_SEATING_MM = 2.0  # a sphere farther off its place is not on the same post
LARGEST_DEVIATION_MM, LARGEST_DEVIATION_RAD = 20.0, 0.1  # of one joint or link: fifty times what is usual

LONGEST_TRAVEL_MM = 100.0  # of a dial gauge
SHORTEST_BORE_MM = 15.0  # a shorter bore does not guide; 85 mm in centimetres would be less
LONGEST_LIFE = timedelta(days=366)  # of a record; also the most that a calibration accepts for --days


def not_in_metres(shortest_mm: float) -> AfterValidator:
    """Build a validator for a length of 0 or at least `shortest_mm`; values in metres would fall below it."""

    def check_millimetres(length_mm: float) -> float:
        if 0.0 < length_mm < shortest_mm:
            raise ValueError("give millimetres, not metres")
        return length_mm

    return AfterValidator(check_millimetres)


def not_in_micrometres(largest_mm: float) -> AfterValidator:
    """Build a validator for an error below `largest_mm`; values in micrometres would exceed it."""

    def check_millimetres(error_mm: float) -> float:
        if error_mm >= largest_mm:
            raise ValueError(f"expected less than {largest_mm:g} mm: give millimetres, not micrometres")
        return error_mm

    return AfterValidator(check_millimetres)


def farther_than(shortest_mm: float, farthest_mm: float = FARTHEST_MM) -> AfterValidator:
    """Build a validator for a position at its origin or plausibly far from it; metres would be too close."""

    def check_millimetres(place_mm: tuple[float, float, float]) -> tuple[float, float, float]:
        if 0.0 < (length_mm := math.hypot(*place_mm)) < shortest_mm:
            raise ValueError(f"has length {length_mm:.3g}: give millimetres, not metres")
        if length_mm > farthest_mm:
            raise ValueError(f"has length {length_mm:.6g}: expected at most {farthest_mm:g} mm")
        return place_mm

    return AfterValidator(check_millimetres)


def check_on_holder(place_mm: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a place on a holder that is far enough from the flange; centimetres would be too close."""
    if (length_mm := math.hypot(*place_mm)) < NEAREST_ON_HOLDER_MM:
        raise ValueError(
            f"has length {length_mm:.3g}: expected at least {NEAREST_ON_HOLDER_MM:g} mm from the flange: "
            "give millimetres, not centimetres"
        )
    return place_mm


def are_degrees(angles: tuple[float, ...]) -> bool:
    """Return whether any angle would exceed a full turn if in radians, so the pose must be in degrees."""
    return any(abs(angle) > math.tau for angle in angles)


def _check_bore_length(length_mm: float) -> float:
    if 0.0 < length_mm < SHORTEST_BORE_MM:
        raise ValueError(
            f"is {length_mm:g}, expected at least {SHORTEST_BORE_MM:g} mm: give millimetres, not centimetres"
        )
    return length_mm


def _check_focal_pixels(focal_px: float) -> float:
    if focal_px < SHORTEST_FOCAL_PX:
        raise ValueError("give the focal length in pixels, not in millimetres or metres")
    return focal_px


def _require_text(text: str) -> str:
    if not text.strip():
        raise ValueError("is empty")
    return text


Words = Annotated[str, AfterValidator(_require_text)]
Length = not_in_metres(SHORTEST_MM)  # of something large enough to tell metres from millimetres
BoreLength = AfterValidator(_check_bore_length)
FocalPixels = Annotated[float, Field(gt=0, le=LONGEST_FOCAL_PX), AfterValidator(_check_focal_pixels)]
SensorPixels = Annotated[int, Field(ge=16, le=65_535)]  # a GigE Vision image is no larger
StatedError = Annotated[
    float, Field(gt=0), not_in_metres(FINEST_MM), not_in_micrometres(LARGEST_MEASURED_ERROR_MM)
]
MountedError = Annotated[
    float, Field(gt=0), not_in_metres(FINEST_ON_ARM_MM), not_in_micrometres(LARGEST_MOUNTED_ERROR_MM)
]
Scatter = Annotated[float, Field(gt=0, le=LARGEST_ARM_ERROR_MM), not_in_metres(FINEST_SCATTER_MM)]
ArmError = Annotated[float, Field(gt=0, le=LARGEST_ARM_ERROR_MM), not_in_metres(FINEST_ON_ARM_MM)]
SeatingError = Annotated[float, Field(ge=0, le=LARGEST_SEATING_MM), not_in_metres(FINEST_ON_ARM_MM)]
DeviationMm = Annotated[float, Field(ge=-LARGEST_DEVIATION_MM, le=LARGEST_DEVIATION_MM)]
DeviationRad = Annotated[float, Field(ge=-LARGEST_DEVIATION_RAD, le=LARGEST_DEVIATION_RAD)]
DialReading = Annotated[float, Field(ge=-LONGEST_TRAVEL_MM, le=LONGEST_TRAVEL_MM)]
JointDegrees = Annotated[float, Field(ge=-720, le=720)]  # no axis turns twice; its own range is the arm's


# Files and records are named after a trajectory: no path, no line break, nothing that a shell reads.
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
LONGEST_NAME = 32
LEAST_DEPTH_MM = 1.0  # entry and target closer than this are the same point to every instrument here
# Safety against a plan deeper than a head (U).
MOST_DEPTH_MM = 150.0  # from one side of a head to far beyond its middle; anything longer is a typing error

LARGEST_MARGIN_MM = 20.0  # accepted error at a target
LARGEST_ANGLE_DEG = 360.0  # about the axis, either way

TrajectoryName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=NAME_PATTERN)]
FreeAngle = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST_ANGLE_DEG, le=LARGEST_ANGLE_DEG)]
Margin = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=LARGEST_MARGIN_MM)]
