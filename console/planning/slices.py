"""Slices for a page: its view, and the plane of each image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from console.planning.draft import DraftTrajectory
from console.planning.fused_series import ShownSeries
from console.planning.views import PlanView
from procedures.imaging.volume import VoxelGeometry
from procedures.strategies.trajectory import Point
from ronna_hw.arrays import Array

SIZE_PX = 512  # of an image, which is square; a scanner's usual matrix
# Lowest and highest HU shown. Brain and bone are the presets that radiology uses for the head: width 80 at
# level 40, width 1800 at level 400. Spheres are plastic: below bone, set off against air at -1000.
WINDOWS_HU = {"brain": (0.0, 80.0), "bone": (-500.0, 1300.0), "spheres": (-1000.0, 600.0)}
ZOOMS = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
TURN_DEG = 5.0  # of the image along a trajectory, per step of the wheel


class Plane(StrEnum):
    """Image planes."""

    AXIAL = "axial"
    CORONAL = "coronal"
    SAGITTAL = "sagittal"
    ALONG = "along"


# To the right and down in the image, LPS: as seen from the feet, from the front, from the left.
DIRECTIONS: dict[Plane, tuple[Point, Point]] = {
    Plane.AXIAL: ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    Plane.CORONAL: ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    Plane.SAGITTAL: ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
}


@dataclass(frozen=True, eq=False)
class Cut:
    """Image plane in LPS: centre, and unit vectors right and down. `step_mm` is the pixel size."""

    middle_mm: Array
    right: Array
    down: Array
    step_mm: float

    @cached_property
    def normal(self) -> Array:
        """Unit vector into the image."""
        return np.asarray(np.cross(self.right, self.down))

    def to_patient_mm(self, x_px: float, y_px: float) -> Point:
        """Convert image coordinates to LPS. (0, 0) is the corner of the first pixel."""
        half = SIZE_PX / 2.0
        place = self.middle_mm + self.step_mm * ((x_px - half) * self.right + (y_px - half) * self.down)
        return as_point(place)

    def to_picture(self, place_mm: ArrayLike) -> tuple[float, float, float]:
        """Return the image coordinates of an LPS point in px, and its depth behind the image in mm."""
        away = np.asarray(place_mm, dtype=float) - self.middle_mm
        half = SIZE_PX / 2.0
        return (
            half + float(away @ self.right) / self.step_mm,
            half + float(away @ self.down) / self.step_mm,
            float(away @ self.normal),
        )


def as_point(place: ArrayLike) -> Point:
    x, y, z = (float(value) for value in np.asarray(place))
    return x, y, z


@dataclass
class PageView:
    """View of one page. All images pass through the crosshair, except the image along a trajectory."""

    geometry: VoxelGeometry
    place_mm: Point = (0.0, 0.0, 0.0)
    zoom: int = 0  # step of ZOOMS
    focus_mm: Point = (0.0, 0.0, 0.0)  # centre of a magnified image
    window: str = "spheres"  # to be judged first, as long as there is no target
    turn_deg: float = 0.0
    series: ShownSeries = ShownSeries.CT
    series_words: str = ""  # beside each picture, unless it is of the CT
    way: str = "T1"  # the one being edited
    large: PlanView = PlanView.AXIAL
    measured_mm: tuple[Point, ...] = ()  # ends of the measured distance, as far as they are clicked
    _bounds: tuple[Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        corners = np.array(np.meshgrid(*[(-0.5, n - 0.5) for n in self.geometry.shape])).reshape(3, -1).T
        places = self.geometry.to_patient_mm(corners)
        self._bounds = places.min(axis=0), places.max(axis=0)
        self.place_mm = self.focus_mm = as_point((self._bounds[0] + self._bounds[1]) / 2.0)

    @property
    def step_mm(self) -> float:
        """Pixel size in mm. At the lowest zoom the whole scan fits."""
        return float((self._bounds[1] - self._bounds[0]).max()) / SIZE_PX / ZOOMS[self.zoom]

    def cut(self, plane: Plane, way: DraftTrajectory | None) -> Cut | None:
        """Return the image plane, or None along an incomplete trajectory."""
        if plane is Plane.ALONG:
            return None if way is None or way.ends is None else self._cut_along(*way.ends)
        right, down = (np.array(item) for item in DIRECTIONS[plane])
        normal = np.cross(right, down)
        focus, place = np.array(self.focus_mm), np.array(self.place_mm)
        return Cut(focus + normal * float((place - focus) @ normal), right, down, self.step_mm)

    def _cut_along(self, entry_mm: Point, target_mm: Point) -> Cut | None:
        entry, target = np.array(entry_mm), np.array(target_mm)
        length_mm = float(np.linalg.norm(target - entry))
        if length_mm == 0.0:
            return None
        down = (target - entry) / length_mm
        helper = np.eye(3)[int(np.abs(down).argmin())]
        right = np.cross(down, helper)
        right /= np.linalg.norm(right)
        turn = math.radians(self.turn_deg)
        turned = math.cos(turn) * right + math.sin(turn) * np.cross(down, right)
        return Cut((entry + target) / 2.0, turned, down, self.step_mm)

    def open_on(self, ways: Sequence[DraftTrajectory]) -> None:
        """Begin at the first target, with the brain visible, if there is any."""
        way = next((item for item in ways if item.target_mm is not None), None)
        if way is not None and way.target_mm is not None:
            self.way, self.window = way.identifier, "brain"
            self.go_to(way.target_mm)

    def measure(self, place_mm: Point) -> None:
        """Set one end of the measured distance, or begin anew after both."""
        known = () if len(self.measured_mm) == 2 else self.measured_mm
        self.measured_mm = (*known, place_mm)

    def go_to(self, place_mm: Point) -> None:
        """Move the crosshair to a position within the scan."""
        low, high = self._bounds
        self.place_mm = as_point(np.clip(place_mm, low, high))

    def scroll(self, plane: Plane, steps: int) -> None:
        """Scroll by a number of slices, or rotate the image along a trajectory."""
        if plane is Plane.ALONG:
            self.turn_deg = (self.turn_deg + TURN_DEG * steps) % 360.0
            return
        right, down = (np.array(item) for item in DIRECTIONS[plane])
        normal = np.cross(right, down)
        axis = int(np.abs(normal @ self.geometry.axes).argmax())
        self.go_to(as_point(np.array(self.place_mm) + normal * steps * self.geometry.spacing_mm[axis]))

    def move(self, plane: Plane, right: int, down: int) -> None:
        """Move the crosshair within an image, in image pixels."""
        if plane is Plane.ALONG:
            return
        across, downwards = (np.array(item) for item in DIRECTIONS[plane])
        self.go_to(as_point(np.array(self.place_mm) + self.step_mm * (right * across + down * downwards)))

    def magnify(self, steps: int) -> None:
        """Zoom about the crosshair. Fully zoomed out, show the whole scan."""
        self.zoom = min(max(self.zoom + steps, 0), len(ZOOMS) - 1)
        low, high = self._bounds
        self.focus_mm = self.place_mm if self.zoom else as_point((low + high) / 2.0)
