"""The view of one page: crosshair, zoom, CT window, and rotation of the image along a trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from console.pictures.cuts import DIRECTIONS, SIZE_PX, WINDOWS_HU, Cut, Plane, point
from console.planning.draft import Way
from procedures.imaging.volume import VoxelGeometry
from procedures.strategies.trajectory import Point

Array = NDArray[np.float64]

ZOOMS = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
TURN_DEG = 5.0  # of the image along a trajectory, per step of the wheel


@dataclass
class Look:
    """For one page. Every image passes through the crosshair except the one along a trajectory."""

    geometry: VoxelGeometry
    place_mm: Point = (0.0, 0.0, 0.0)
    zoom: int = 0  # step of ZOOMS
    focus_mm: Point = (0.0, 0.0, 0.0)  # centre of a magnified image
    window: str = next(iter(WINDOWS_HU))
    turn_deg: float = 0.0
    way: str = "T1"  # the one being edited
    _bounds: tuple[Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        corners = np.array(np.meshgrid(*[(-0.5, n - 0.5) for n in self.geometry.shape])).reshape(3, -1).T
        places = self.geometry.to_patient_mm(corners)
        self._bounds = places.min(axis=0), places.max(axis=0)
        self.place_mm = self.focus_mm = point((self._bounds[0] + self._bounds[1]) / 2.0)

    @property
    def step_mm(self) -> float:
        """Size of a pixel: without zoom the whole scan fits."""
        return float((self._bounds[1] - self._bounds[0]).max()) / SIZE_PX / ZOOMS[self.zoom]

    def cut(self, plane: Plane, way: Way | None) -> Cut | None:
        """The image of a plane; None along an incomplete trajectory."""
        if plane is Plane.ALONG:
            return None if way is None or way.ends is None else self._along(*way.ends)
        right, down = (np.array(one) for one in DIRECTIONS[plane])
        normal = np.cross(right, down)
        focus, place = np.array(self.focus_mm), np.array(self.place_mm)
        return Cut(focus + normal * float((place - focus) @ normal), right, down, self.step_mm)

    def _along(self, entry_mm: Point, target_mm: Point) -> Cut | None:
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

    def go_to(self, place_mm: Point) -> None:
        """Move the crosshair, within the scan."""
        low, high = self._bounds
        self.place_mm = point(np.clip(place_mm, low, high))

    def scroll(self, plane: Plane, steps: int) -> None:
        """Scroll by this many slices."""
        if plane is Plane.ALONG:
            self.turn_deg = (self.turn_deg + TURN_DEG * steps) % 360.0
            return
        right, down = (np.array(one) for one in DIRECTIONS[plane])
        normal = np.cross(right, down)
        axis = int(np.abs(normal @ self.geometry.axes).argmax())
        self.go_to(point(np.array(self.place_mm) + normal * steps * self.geometry.spacing_mm[axis]))

    def move(self, plane: Plane, right: int, down: int) -> None:
        """Move the crosshair within an image, by its pixels."""
        if plane is Plane.ALONG:
            return
        across, downwards = (np.array(one) for one in DIRECTIONS[plane])
        self.go_to(point(np.array(self.place_mm) + self.step_mm * (right * across + down * downwards)))

    def magnify(self, steps: int) -> None:
        """In or out, about the crosshair; the whole scan again when fully zoomed out."""
        self.zoom = min(max(self.zoom + steps, 0), len(ZOOMS) - 1)
        low, high = self._bounds
        self.focus_mm = self.place_mm if self.zoom else point((low + high) / 2.0)
