"""One look of the stereo head at a sphere: a triggered pair, two outlines, one point in the tool frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

from procedures.relocalization.errors import (
    NoContrast,
    NoSphere,
    NotTrusted,
    PairNotUsable,
    RaysDoNotMeet,
    WrongSize,
)
from procedures.relocalization.outline import SphereImage
from procedures.relocalization.sphere_measurement import AreaImage, locate_sphere
from procedures.relocalization.triangulation import Camera, StereoPoint
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.clock import Clock
from ronna_hw.devices import StereoPair
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, StereoReading, Validity
from ronna_hw.errors import RonnaError

# What a look may end with when the sphere is not there, or is another thing; everything else is a fault.
NOT_SEEN = (NoContrast, NoSphere, RaysDoNotMeet, WrongSize)
FURTHER_TRIES = 2  # a lost image is an everyday matter on a network; three in a row are a fault
CLOCK_ERROR_S = 0.1  # theatre time; between the clocks of cameras and theatre. The arm rests for longer
OFFSET_STEP_PX = 16  # of the older firmware of the camera family; newer firmware takes any


@dataclass(frozen=True)
class Look:
    """What one look gave; `point` is None when no sphere could be measured in both images."""

    reading: StereoReading
    left: SphereImage | None
    right: SphereImage | None
    point: StereoPoint | None
    problem: RonnaError | None = None

    @property
    def reason(self) -> str:
        """What kept it from giving a point, in words."""
        return "" if self.problem is None else self.problem.what


def area_around_tool(camera: CameraCalibration, size_px: tuple[int, int]) -> AreaOfInterest:
    """The area of that size whose middle is where the tool centre point appears, inside the sensor."""
    columns, rows = camera.sensor_px
    width, height = min(size_px[0], columns), min(size_px[1], rows)
    (x, y), _ = Camera(camera).project((0.0, 0.0, 0.0))
    return AreaOfInterest(
        offset_x=_offset(x, width, columns), offset_y=_offset(y, height, rows), width=width, height=height
    )


def whole_sensor(camera: CameraCalibration) -> AreaOfInterest:
    """The area of the whole sensor."""
    columns, rows = camera.sensor_px
    return AreaOfInterest(0, 0, columns, rows)


def look(stereo: StereoPair, calibration: StereoHeadCalibration, clock: Clock) -> Look:
    """Take a pair and measure the sphere in it; one that did not come whole, or is old, is taken again.

    Raises STE-012 when none does: to search for the sphere elsewhere would not help.
    """
    for _ in range(1 + FURTHER_TRIES):
        reading = _grabbed(stereo, clock)
        if reading.validity is Validity.OK:
            break
    if reading.validity is not Validity.OK or reading.left is None or reading.right is None:
        raise PairNotUsable(
            "no usable pair of images",
            limit=f"{1 + FURTHER_TRIES} pairs in a row",
            got=f"the pair is {reading.validity}: {_sides(reading)}",
        )
    images = (_placed(reading.left), _placed(reading.right))
    try:
        seen = locate_sphere(*images, calibration)
    except NOT_SEEN as error:
        return Look(reading, None, None, None, error)
    problem = None
    if seen.point is None:
        rims = f"{seen.left.rim_fraction:.0%} left, {seen.right.rim_fraction:.0%} right"
        problem = NotTrusted(seen.doubt, got=f"rim in view {rims}")
    return Look(reading, seen.left, seen.right, seen.point, problem)


def _grabbed(stereo: StereoPair, clock: Clock) -> StereoReading:
    """A pair; STALE when it was exposed before it was asked for, when the arm was elsewhere."""
    asked_s = clock.now_s()
    reading = stereo.grab_pair()
    sides = (side for side in (reading.left, reading.right) if side is not None)
    measured_s = [side.stamp.measured_s for side in sides if side.stamp.measured_s is not None]
    old = min((reading.stamp.theatre_time_s, *measured_s)) < asked_s - CLOCK_ERROR_S
    return replace(reading, validity=Validity.STALE) if old and reading.validity is Validity.OK else reading


def _sides(reading: StereoReading) -> str:
    sides = (("left", reading.left), ("right", reading.right))
    return ", ".join(f"{name} {image.validity if image else 'no image'}" for name, image in sides)


def _placed(image: CameraImage) -> AreaImage:
    return AreaImage(image.pixels, image.area.offset_x, image.area.offset_y)


def _offset(centre_px: float, size: int, whole: int) -> int:
    wanted = round((centre_px - size / 2) / OFFSET_STEP_PX) * OFFSET_STEP_PX
    largest = (whole - size) // OFFSET_STEP_PX * OFFSET_STEP_PX
    return max(0, min(wanted, largest))
