"""Stereo head looks at the projector's line: a pair with the line, and one without."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.registration.surface.errors import ARM_NOT_CALIBRATED, NO_PATIENT_FRAME, NO_PROJECTOR
from procedures.relocalization.errors import LINES_DO_NOT_MATCH, NOT_IN_A_PLANE, NoLine, Saturated
from procedures.relocalization.laser_line import LineImage, measure_line
from procedures.relocalization.line_points import LinePoints, triangulate_line
from procedures.workcell.stereo_look import area_image, grab_usable
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.clock import Clock
from ronna_hw.config import Calibrations
from ronna_hw.devices import StereoPair
from ronna_hw.devices.readings import StereoReading
from ronna_hw.devices.sensors import ProjectsLine, line_projector
from ronna_hw.errors import RonnaError, is_error

# Errors that mean no line on the skin here, or one that says nothing; everything else is a fault.
NOT_SEEN = (NoLine, Saturated, LINES_DO_NOT_MATCH, NOT_IN_A_PLANE)


@dataclass(frozen=True)
class LineLook:
    """Result of one look at the line. `points` is None unless it was measured in both images."""

    reading: StereoReading
    left: LineImage | None
    right: LineImage | None
    points: LinePoints | None
    problem: RonnaError | None = None


def require_scanner(stereo: StereoPair, patient_frame: str | None, calibrations: Calibrations | None) -> None:
    """Raise SRF-030, SRF-031 or SRF-034 unless a theatre can scan the skin and watch the head meanwhile."""
    _require_projector(stereo)
    if patient_frame is None:
        raise NO_PATIENT_FRAME("this theatre has no frame on the head clamp")
    if calibrations is None or calibrations.arm is None:
        raise ARM_NOT_CALIBRATED("the arm of this theatre has no calibration record")


def _require_projector(stereo: StereoPair) -> ProjectsLine:
    if (projector := line_projector(stereo)) is None:
        raise NO_PROJECTOR("the stereo head of this theatre has no line projector")
    return projector


def look_at_line(stereo: StereoPair, calibration: StereoHeadCalibration, clock: Clock) -> LineLook:
    """Take a pair without the line and one with it, and measure the points of what is lit.

    The line is lit for its own pair alone: no laser shines while the arm moves or somebody is asked.
    Raises SRF-030 without a projector, STE-012 without a usable pair.
    """
    projector = _require_projector(stereo)
    dark = grab_usable(stereo, clock)
    projector.set_projector(True)
    try:
        reading = grab_usable(stereo, clock)
    finally:
        projector.set_projector(False)
    left = right = None
    try:
        left = measure_line(area_image(reading.left), area_image(dark.left))
        right = measure_line(area_image(reading.right), area_image(dark.right))
        return LineLook(reading, left, right, triangulate_line(left, right, calibration))
    except RonnaError as problem:
        if not is_error(problem, *NOT_SEEN):
            raise
        return LineLook(reading, left, right, None, problem)
