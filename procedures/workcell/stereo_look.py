"""Stereo head looks at a sphere: a triggered pair, two outlines, one point in the tool frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.relocalization import errors
from procedures.relocalization.grey_image import AreaImage
from procedures.relocalization.laser_line import LineImage
from procedures.relocalization.outline import SphereImage, SphereStatus
from procedures.relocalization.sphere_measurement import locate_sphere, sphere_radius_px
from procedures.relocalization.triangulation import SPHERE_DIAMETER_MM, StereoPoint, camera_model
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.clock import Clock
from ronna_hw.devices import StereoPair
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, StereoReading, Validity
from ronna_hw.errors import RonnaError

# Errors that mean no sphere, or another object; everything else is a fault.
NOT_SEEN = (errors.NoContrast, errors.NoSphere, errors.RaysDoNotMeet, errors.WrongSize)
FURTHER_TRIES = 2  # a lost image is an everyday matter on a network; three in a row are a fault
# Safety against a picture from before the arm was there (U).
CLOCK_ERROR_S = 0.1  # theatre time, between the clocks of cameras and theatre; the arm rests for longer

OFFSET_STEP_PX = 16  # of the older firmware of the camera family; newer firmware takes any
# Readout around a sphere whose place is known: its image and as much around it as the servo leaves, 1.3 mm.
CLOSE_AREA = 1.25  # of the sphere's diameter in the image at the tool centre
PICTURE_HEIGHT_PX = 300  # of the report
TRUSTED_BGR, DOUBTED_BGR, PAPER_BGR = (80, 220, 80), (40, 160, 255), (255, 255, 255)
GAP_PX = 8
CAPTION_PX = 18  # per line
LETTERS, LETTER_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.4
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Look:
    """Result of one look. `point` is None unless a sphere was measured in both images."""

    reading: StereoReading
    left: SphereImage | None
    right: SphereImage | None
    point: StereoPoint | None
    problem: RonnaError | None = None

    @property
    def reason(self) -> str:
        """Why no point was measured; empty if one was."""
        return "" if self.problem is None else self.problem.what


class PicturedLook(Protocol):
    """Look at a sphere or a line, as its picture shows it."""

    @property
    def reading(self) -> StereoReading:
        """Images that were taken."""
        ...

    @property
    def left(self) -> SphereImage | LineImage | None:
        """Sphere or line in the left image; None unless it was measured."""
        ...

    @property
    def right(self) -> SphereImage | LineImage | None:
        """Sphere or line in the right image; None unless it was measured."""
        ...


def area_around_tool(camera: CameraCalibration, size_px: tuple[int, int]) -> AreaOfInterest:
    """Return a readout area of this size around the image of the tool centre, kept within the sensor."""
    columns, rows = camera.sensor_px
    width, height = min(size_px[0], columns), min(size_px[1], rows)
    (x, y), _ = camera_model(camera).project((0.0, 0.0, 0.0))
    return AreaOfInterest(
        offset_x=_offset(x, width, columns), offset_y=_offset(y, height, rows), width=width, height=height
    )


def close_area_px(camera: CameraCalibration) -> int:
    """Return the side of a readout area that holds a sphere near the tool centre, and a margin."""
    side_px = CLOSE_AREA * 2.0 * sphere_radius_px(camera, SPHERE_DIAMETER_MM)
    return math.ceil(side_px / OFFSET_STEP_PX) * OFFSET_STEP_PX


def whole_sensor(camera: CameraCalibration) -> AreaOfInterest:
    """Return the area covering the whole sensor."""
    columns, rows = camera.sensor_px
    return AreaOfInterest(0, 0, columns, rows)


def look(
    stereo: StereoPair, calibration: StereoHeadCalibration, clock: Clock, *, enhance_contrast: bool = False
) -> Look:
    """Take a stereo pair and measure the sphere in it, retrying if the pair is incomplete or stale.

    `enhance_contrast` equalizes both images first, as the thesis does.
    Raises STE-012 if none is usable: a search elsewhere would not help.
    """
    reading = grab_usable(stereo, clock)
    images = (area_image(reading.left), area_image(reading.right))
    try:
        seen = locate_sphere(*images, calibration, enhance_contrast=enhance_contrast)
    except NOT_SEEN as error:
        return Look(reading, None, None, None, error)
    problem = None
    if seen.point is None:
        rims = f"{seen.left.rim_fraction:.0%} left, {seen.right.rim_fraction:.0%} right"
        problem = errors.NotTrusted(seen.doubt, got=f"rim in view {rims}")
    return Look(reading, seen.left, seen.right, seen.point, problem)


def grab_usable(stereo: StereoPair, clock: Clock) -> StereoReading:
    """Take a fresh and complete pair, retrying twice. Raises STE-012 if none is usable."""
    for _ in range(1 + FURTHER_TRIES):
        reading = _grab(stereo, clock)
        if reading.validity is Validity.OK:
            break
    if reading.validity is not Validity.OK or reading.left is None or reading.right is None:
        raise errors.PairNotUsable(
            "no usable pair of images",
            limit=f"{1 + FURTHER_TRIES} pairs in a row",
            got=f"the pair is {reading.validity}: {_describe_sides(reading)}",
        )
    return reading


def _grab(stereo: StereoPair, clock: Clock) -> StereoReading:
    """Grab a pair; mark it STALE if it was exposed before the request, when the arm was elsewhere."""
    requested_s = clock.now_s()
    reading = stereo.grab_pair()
    sides = (side for side in (reading.left, reading.right) if side is not None)
    measured_s = [side.stamp.measured_s for side in sides if side.stamp.measured_s is not None]
    old = min((reading.stamp.theatre_time_s, *measured_s)) < requested_s - CLOCK_ERROR_S
    return replace(reading, validity=Validity.STALE) if old and reading.validity is Validity.OK else reading


def _describe_sides(reading: StereoReading) -> str:
    sides = (("left", reading.left), ("right", reading.right))
    return ", ".join(f"{name} {image.validity if image else 'no image'}" for name, image in sides)


def area_image(image: CameraImage | None) -> AreaImage:
    """Return a camera's image of an area for measuring. Raises STE-012 without one."""
    if image is None:
        raise errors.PairNotUsable("a camera of the pair gave no image")
    return AreaImage(image.pixels, image.area.offset_x, image.area.offset_y)


def _offset(centre_px: float, size: int, whole: int) -> int:
    wanted = round((centre_px - size / 2) / OFFSET_STEP_PX) * OFFSET_STEP_PX
    largest = (whole - size) // OFFSET_STEP_PX * OFFSET_STEP_PX
    return max(0, min(wanted, largest))


class Sensors:
    """Readout area and exposure of the stereo head's cameras."""

    def __init__(self, stereo: Callable[[], StereoPair], head: StereoHeadCalibration) -> None:
        self._stereo = stereo
        self._head = head
        self._exposure_share = 1.0  # of the configured one

    def read_around_tool(self, size_px: tuple[int, int]) -> None:
        """Read out only this many columns and rows around the tool centre, for speed."""
        left, right = (area_around_tool(side, size_px) for side in (self._head.left, self._head.right))
        self._stereo().set_areas(left, right)

    def read_around_sphere(self, largest_px: tuple[int, int]) -> None:
        """Read out the image of a sphere at the tool centre and a margin, at most `largest_px` around it."""
        columns, rows = largest_px
        left, right = (
            area_around_tool(side, (min(close_area_px(side), columns), min(close_area_px(side), rows)))
            for side in (self._head.left, self._head.right)
        )
        self._stereo().set_areas(left, right)

    def read_whole(self) -> None:
        """Read out both whole sensors."""
        self._stereo().set_areas(whole_sensor(self._head.left), whole_sensor(self._head.right))

    def expose(self, share: float) -> None:
        """Expose both sensors for a fraction of the configured exposure time."""
        if share != self._exposure_share:
            self._stereo().scale_exposure(share)
            self._exposure_share = share


def pair_picture(seen: PicturedLook, height_px: int = PICTURE_HEIGHT_PX) -> bytes:
    """Return the available images side by side as PNG, with the fitted outlines or the line's centres."""
    sides = (("left", seen.reading.left, seen.left), ("right", seen.reading.right, seen.right))
    drawn = [_draw(name, image, sphere, height_px) for name, image, sphere in sides if image is not None]
    height = min((picture.shape[0] for picture in drawn), default=height_px)
    gap = np.full((height, GAP_PX, 3), PAPER_BGR, dtype=np.uint8)
    parts = [part for picture in drawn for part in (gap, picture[:height])]
    picture = np.hstack([*parts[1:], *([] if parts else [gap])])
    _, content = cv2.imencode(".png", picture)
    return content.tobytes()


def _draw(side: str, image: CameraImage, seen: SphereImage | LineImage | None, height_px: int) -> Picture:
    pixels = image.pixels
    eight_bit = pixels if pixels.dtype == np.uint8 else (pixels >> 4).astype(np.uint8)
    scale = height_px / pixels.shape[0]
    small = cv2.resize(eight_bit, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    colour = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    lines = (f"{side} {image.serial}", _describe(seen))
    caption = np.full((len(lines) * CAPTION_PX, colour.shape[1], 3), PAPER_BGR, dtype=np.uint8)
    for number, words in enumerate(lines, start=1):
        (width_px, _), _ = cv2.getTextSize(words, LETTERS, LETTER_SCALE, 1)
        letters = LETTER_SCALE * min(1.0, (caption.shape[1] - 4) / width_px)  # whole on a narrow image too
        cv2.putText(caption, words, (2, number * CAPTION_PX - 6), LETTERS, letters, (0, 0, 0), 1, cv2.LINE_AA)

    def place(centre_px: ArrayLike) -> list[int]:
        corner_px = (image.area.offset_x, image.area.offset_y)
        return [round(value) for value in (np.subtract(centre_px, corner_px) * scale).tolist()]

    if isinstance(seen, SphereImage):
        ink = TRUSTED_BGR if seen.status is SphereStatus.OK else DOUBTED_BGR
        radius, centre = round(scale * (seen.axes_px[0] + seen.axes_px[1]) / 2), place(seen.centre_px)
        cv2.circle(colour, centre, radius, ink, 1, cv2.LINE_AA)
        cv2.drawMarker(colour, centre, ink, cv2.MARKER_CROSS, 14, 1, cv2.LINE_AA)
    elif seen is not None:
        for centre_px in seen.centres_px:
            cv2.circle(colour, place(centre_px), 1, TRUSTED_BGR, -1, cv2.LINE_AA)
    return np.asarray(np.vstack([caption, colour]), dtype=np.uint8)


def _describe(seen: SphereImage | LineImage | None) -> str:
    if seen is None:
        return "not found"
    if isinstance(seen, LineImage):
        return f"line of {len(seen.centres_px)} points"
    x, y = seen.centre_px
    return f"{x:.2f} {y:.2f} px, rim {seen.rim_fraction:.0%}, {seen.doubt or seen.status}"
