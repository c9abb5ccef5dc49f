"""Centre errors over many rendered pairs: centred, out of focus, off axis, occluded and stained, half hidden.

Each row counts what the measurement accepts, and the true errors of the accepted points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.stereo_head.stereo_alternatives import (
    centroid,
    contour_ellipse,
    hough,
    least_error_px,
    triangulated,
)
from benchmarks.stereo_head.stereo_pictures import EXPOSURE_US, GAIN_RAW, Case, Pair, Studio, View
from procedures.relocalization import SphereImage, SphereStatus, measure_sphere, triangulate
from procedures.relocalization.errors import NoSphere, RaysDoNotMeet, WrongSize
from procedures.relocalization.triangulation import Camera
from ronna_hw.frames import Frame
from sim.basler.optics.light import BACKGROUND_ELECTRONS_PER_US, FILM_ELECTRONS_PER_US

Array = NDArray[np.float64]

# An edge that covers 20 % of a disc's width hides 0.295 of its rim.
CENTRED = Case("centred, unoccluded")
DEFOCUSED = Case("centred, 3 px out of focus", deeper_mm=10.0)
OFF_AXIS = Case("up to 3 mm off", reach_mm=3.0)
OCCLUDED = Case("20 % of the width hidden, 3 % stained", rim_lost=(0.295, 0.295), stained=0.03)
HALF_HIDDEN = Case("38 to 60 % of the rim hidden", reach_mm=2.5, rim_lost=(0.38, 0.60))
JUST_HIDDEN = Case("38 to 42 % of the rim hidden", reach_mm=2.5, rim_lost=(0.38, 0.42), stained=0.03)
UNITY_GAIN_RAW = 32
HONEST = (0.7, 1.4)  # chi square per degree of freedom, as for the CT: goal 6
LIMB = 0.75  # brightness of the film at the rim


@dataclass
class Tally:
    """The content of one row of the table."""

    images: int = 0
    trusted: int = 0
    errors_mm: list[Array] = field(default_factory=list)
    squared_sigmas: list[float] = field(default_factory=list)  # of each point's error, by its covariance
    bounds_mm: list[float] = field(default_factory=list)
    others_mm: dict[str, list[float]] = field(default_factory=dict)

    @property
    def rms_um(self) -> float:
        """Root mean square 3-D error of the points returned."""
        return _rms_um([float(np.linalg.norm(error)) for error in self.errors_mm])

    @property
    def largest_um(self) -> float:
        """Largest 3-D error."""
        return 1e3 * max((float(np.linalg.norm(error)) for error in self.errors_mm), default=float("nan"))

    @property
    def bound_um(self) -> float:
        """The Cramér-Rao bound on the 3-D rms error."""
        return _rms_um(self.bounds_mm)

    @property
    def chi_square(self) -> float:
        """Mean of the squared error in units of the stated covariance, per degree of freedom."""
        return float(np.mean(self.squared_sigmas)) / 3.0

    @property
    def distrusted_share(self) -> float:
        """Share of the images without a reliable centre."""
        return 1.0 - self.trusted / self.images


OTHERS: dict[str, Callable[[NDArray[np.uint8], float], Array]] = {
    "threshold and centroid": centroid,
    "OpenCV fitEllipseDirect": contour_ellipse,
    "OpenCV HoughCircles": hough,
}


def campaign(studio: Studio, case: Case, count: int, *, seed: int = 3, others: int = 0) -> Tally:
    """Measure `count` pairs of a case; the alternatives get the first `others` of them."""
    calibration = studio.calibration()
    cameras = (
        Camera(calibration.left, Frame.CAMERA_LEFT),
        Camera(calibration.right, Frame.CAMERA_RIGHT),
    )
    tally = Tally(others_mm={name: [] for name in OTHERS if others})
    for number, pair in enumerate(studio.pairs(case, count, seed)):
        outlines = [_measured(view, tally) for view in pair.views]
        if number < others:
            _others(pair, cameras, tally)
        left, right = outlines
        if left is None or right is None:
            continue
        try:
            point = triangulate(left, right, calibration)
        except (RaysDoNotMeet, WrongSize):
            continue
        error = point.position_mm - pair.centre_mm
        tally.errors_mm.append(error)
        tally.squared_sigmas.append(float(error @ np.linalg.solve(point.covariance_mm2, error)))
        tally.bounds_mm.append(_bound_mm((left, right), cameras, pair.centre_mm))
    return tally


def _measured(view: View, tally: Tally) -> SphereImage | None:
    """The outline if it is reliable."""
    tally.images += 1
    try:
        found = measure_sphere(view.picture)
    except NoSphere:
        return None
    if found.status is not SphereStatus.OK:
        return None
    tally.trusted += 1
    return found.shifted(*view.offset_px)


def _others(pair: Pair, cameras: tuple[Camera, Camera], tally: Tally) -> None:
    for name, method in OTHERS.items():
        left, right = (method(view.picture, view.radius_px) + view.offset_px for view in pair.views)
        error = triangulated(cameras, (left, right)) - pair.centre_mm
        tally.others_mm[name].append(float(np.linalg.norm(error)))


def _bound_mm(
    outlines: tuple[SphereImage, SphereImage], cameras: tuple[Camera, Camera], place_mm: Array
) -> float:
    """Smallest possible 3-D rms error, with each centre coordinate at its bound."""
    gain = GAIN_RAW / UNITY_GAIN_RAW
    scale = EXPOSURE_US * 255.0 / 11900.0 * gain
    bright, dark = LIMB * FILM_ELECTRONS_PER_US * scale, BACKGROUND_ELECTRONS_PER_US * scale
    normal = np.zeros((3, 3))
    for outline, camera in zip(outlines, cameras, strict=True):
        slope = camera.project(place_mm)[1]
        normal += slope.T @ slope / least_error_px(outline, bright, dark, gain) ** 2
    return float(np.sqrt(np.trace(np.linalg.inv(normal))))


def _rms_um(lengths_mm: list[float]) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.square(lengths_mm)))) if lengths_mm else float("nan")
