"""Picture of the skin that a scan has covered, from the front and from both sides."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.registration.surface.checks import share_covered
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface
from ronna_hw.arrays import Array

PX_PER_MM, EDGE_PX = 1.6, 12
PAPER, SKIN, POINT, INK = (255, 255, 255), (205, 205, 205), (60, 110, 20), (40, 40, 40)  # BGR
# Views by name: outward direction of the skin that is seen, and the axes of the picture, right and up.
VIEWS = {
    "right side": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "left side": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}


def draw_coverage(skin: Surface, points_ct_mm: Array) -> tuple[float, bytes]:
    """Return the covered share of the skin above the jaw, and a PNG picture of it."""
    covered = share_covered(points_ct_mm, skin, HeadAxes.of(skin))
    views = [_draw(skin, points_ct_mm, name, *map(np.array, axes)) for name, axes in VIEWS.items()]
    _, content = cv2.imencode(".png", np.hstack(views))
    return covered, content.tobytes()


def _draw(
    skin: Surface, points_mm: Array, name: str, outwards: Array, right: Array, up: Array
) -> NDArray[np.uint8]:
    seen = skin.points_mm[skin.normals @ outwards > 0.0]
    axes = np.stack([right, -up], axis=1)
    low, high = (skin.points_mm @ axes).min(axis=0), (skin.points_mm @ axes).max(axis=0)
    width, height = np.ceil((high - low) * PX_PER_MM).astype(int) + 2 * EDGE_PX
    picture = np.full((height, width, 3), PAPER, dtype=np.uint8)
    middle = skin.points_mm.mean(axis=0)
    facing = points_mm[(points_mm - middle) @ outwards > 0.0]
    for places, ink, radius in ((seen, SKIN, 2), (facing, POINT, 1)):
        pixels = np.rint((places @ axes - low) * PX_PER_MM).astype(int) + EDGE_PX
        for x, y in pixels.tolist():
            cv2.circle(picture, (x, y), radius, ink, -1)
    cv2.putText(picture, name, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    return picture
