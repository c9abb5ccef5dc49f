"""Skin drawn from the right side, the front and the left side, beside each other, and places on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ronna_hw.arrays import Array

PX_PER_MM, EDGE_PX = 1.6, 12
# Below each view, for its name: legible where three views share the width of a phone.
NAME_PX, NAME_EDGE_PX, NAME_SIZE, NAME_STROKE_PX = 44, 10, 1.3, 2
PAPER, INK = (255, 255, 255), (40, 40, 40)  # BGR
SCANNED, MISSING = (60.0, 110.0, 20.0), (140.0, 40.0, 215.0)  # BGR: green, and pink
DARKEST, BRIGHTEST = 150.0, 235.0  # grey of skin that is seen edge on, and face on
SKIN_PX, POINT_PX = 3, 1
# Views by name: outward direction of the skin that is seen, and the axes of the picture, right and up.
VIEWS = {
    "right side": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "left side": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}

Colours = NDArray[np.float64]
NOWHERE = np.empty((0, 3))


@dataclass(frozen=True)
class _View:
    """One view: its `corner_px` in the whole picture, its axes (3, 2) right and down, and its extent."""

    name: str
    outwards: Array
    axes: Array
    low_mm: Array
    size_px: tuple[int, int]
    corner_px: int

    @classmethod
    def of(cls, name: str, points_mm: Array, corner_px: int) -> Self:
        outwards, right, up = map(np.array, VIEWS[name])
        axes = np.stack([right, -up], axis=1)
        low, high = (points_mm @ axes).min(axis=0), (points_mm @ axes).max(axis=0)
        width, height = (int(one) + 2 * EDGE_PX for one in np.ceil((high - low) * PX_PER_MM))
        return cls(name, outwards, axes, low, (width, height + NAME_PX), corner_px)

    def place(self, places_mm: Array) -> list[list[int]]:
        """Return pixels of the whole picture."""
        pixels = np.rint((places_mm @ self.axes - self.low_mm) * PX_PER_MM).astype(int) + EDGE_PX
        pixels[:, 0] += self.corner_px
        return [[x, y] for x, y in pixels.tolist()]


class DrawnSkin:
    """Picture of samples (n, 3) of the skin with outward normals (n, 3), in the CT, mm."""

    def __init__(self, points_mm: Array, normals: Array) -> None:
        self._points_mm, self._normals = points_mm, normals
        self._middle_mm = points_mm.mean(axis=0)
        self._views: list[_View] = []
        for name in VIEWS:
            self._views.append(_View.of(name, points_mm, self.size_px[0] if self._views else 0))

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        last = self._views[-1]
        return last.corner_px + last.size_px[0], last.size_px[1]

    def place(self, places_mm: Array) -> list[list[int]]:
        """Return the pixels of places (n, 3), once in each view whose half of the head they are on."""
        return [at for view in self._views for at in view.place(places_mm[self._is_near(view, places_mm)])]

    def draw(
        self,
        places_mm: Array = NOWHERE,
        colours: Colours = NOWHERE,
        is_ring: NDArray[np.bool_] | None = None,
        radius_px: int = POINT_PX,
    ) -> bytes:
        """Return a PNG picture with places (n, 3) in their colours (n, 3), BGR, as discs or rings."""
        rings = np.zeros(len(places_mm), dtype=bool) if is_ring is None else is_ring
        width, height = self.size_px
        picture = np.full((height, width, 3), PAPER, dtype=np.uint8)
        for view in self._views:
            self._draw_skin(picture, view)
            near = self._is_near(view, places_mm)
            for at, colour, ring in zip(
                view.place(places_mm[near]), colours[near].tolist(), rings[near], strict=True
            ):
                cv2.circle(picture, at, radius_px, INK if ring else colour, 1 if ring else -1, cv2.LINE_AA)
            _name(picture, view)
        _, content = cv2.imencode(".png", picture)
        return bytes(content.tobytes())

    def _draw_skin(self, picture: NDArray[np.uint8], view: _View) -> None:
        facing = self._normals @ view.outwards
        seen = np.flatnonzero(facing > 0.0)
        seen = seen[
            np.argsort(self._points_mm[seen] @ view.outwards)
        ]  # what is nearer is drawn over the rest
        grey = DARKEST + (BRIGHTEST - DARKEST) * facing[seen]
        for at, level in zip(view.place(self._points_mm[seen]), grey.tolist(), strict=True):
            cv2.circle(picture, at, SKIN_PX, (level, level, level), -1)

    def _is_near(self, view: _View, places_mm: Array) -> NDArray[np.bool_]:
        return np.asarray((places_mm - self._middle_mm) @ view.outwards > 0.0)


def _name(picture: NDArray[np.uint8], view: _View) -> None:
    font = cv2.FONT_HERSHEY_SIMPLEX
    (width_px, _), _ = cv2.getTextSize(view.name, font, NAME_SIZE, NAME_STROKE_PX)
    at = (view.corner_px + (view.size_px[0] - width_px) // 2, picture.shape[0] - NAME_EDGE_PX)
    cv2.putText(picture, view.name, at, font, NAME_SIZE, INK, NAME_STROKE_PX, cv2.LINE_AA)
