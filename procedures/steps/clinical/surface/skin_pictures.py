"""Pictures of the skin from the front and both sides: where a scan has covered it, and how the two differ."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.registration.surface.checks import COVERED_MM, share_covered
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.surface_registration import SurfaceRegistration
from ronna_hw.arrays import Array

COVERAGE_PICTURE, RESIDUALS_PICTURE = "surface-coverage.png", "surface-residuals.png"
PX_PER_MM, EDGE_PX = 1.6, 12
PAPER, POINT, INK = (255, 255, 255), (60, 110, 20), (40, 40, 40)  # BGR
DARKEST, BRIGHTEST = 150.0, 235.0  # grey of skin that is seen edge on, and face on
SKIN_PX, POINT_PX, RESIDUAL_PX = 3, 1, 3
# Distances of points to the skin of the CT: full blue inside it, full red outside it.
FULL_COLOUR_MM = 1.0
INSIDE, BETWEEN, OUTSIDE = np.array([[190, 90, 20], [225, 225, 225], [30, 40, 200]], dtype=float)  # BGR
# Views by name: outward direction of the skin that is seen, and the axes of the picture, right and up.
VIEWS = {
    "right side": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "left side": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}

Colours = NDArray[np.float64]


def draw_coverage(skin: Surface, points_ct_mm: Array) -> tuple[float, bytes]:
    """Return the covered share of the skin above the jaw, and a PNG picture of it."""
    covered = share_covered(points_ct_mm, skin, HeadAxes.of(skin))
    return covered, _draw_views(skin, points_ct_mm, np.tile(np.array(POINT, float), (len(points_ct_mm), 1)))


def tell_coverage(share: float) -> str:
    """Say how much of the head points cover."""
    return f"{share:.0%} of the skin above the jaw lies within {COVERED_MM:g} mm of a point"


def draw_residuals(skin: Surface, found: SurfaceRegistration) -> bytes:
    """Return a PNG picture of the registered points, coloured by their distance to the skin."""
    in_ct_mm = np.asarray(found.robot_from_ct.inverse().apply(found.points_mm))
    return _draw_views(skin, in_ct_mm, colour_residuals(found.residuals_mm), found.excluded, RESIDUAL_PX)


def colour_residuals(distances_mm: Array) -> Colours:
    """Return a colour (n, 3) for each distance, positive outside the skin; one that is not known is grey."""
    share = np.clip(np.nan_to_num(distances_mm) / FULL_COLOUR_MM, -1.0, 1.0)[:, None]
    away = np.where(share < 0.0, BETWEEN - INSIDE, OUTSIDE - BETWEEN)
    return np.asarray(BETWEEN + away * share)


def _draw_views(
    skin: Surface,
    points_mm: Array,
    colours: Colours,
    is_ring: NDArray[np.bool_] | None = None,
    radius_px: int = POINT_PX,
) -> bytes:
    rings = np.zeros(len(points_mm), dtype=bool) if is_ring is None else is_ring
    views = [
        _draw(skin, points_mm, colours, rings, radius_px, name, *map(np.array, axes))
        for name, axes in VIEWS.items()
    ]
    _, content = cv2.imencode(".png", np.hstack(views))
    return bytes(content.tobytes())


def _draw(
    skin: Surface,
    points_mm: Array,
    colours: Colours,
    is_ring: NDArray[np.bool_],
    radius_px: int,
    name: str,
    outwards: Array,
    right: Array,
    up: Array,
) -> NDArray[np.uint8]:
    facing = skin.normals @ outwards
    seen = np.flatnonzero(facing > 0.0)
    seen = seen[np.argsort(skin.points_mm[seen] @ outwards)]  # what is nearer is drawn over the rest
    axes = np.stack([right, -up], axis=1)
    low, high = (skin.points_mm @ axes).min(axis=0), (skin.points_mm @ axes).max(axis=0)
    width, height = np.ceil((high - low) * PX_PER_MM).astype(int) + 2 * EDGE_PX
    picture = np.full((height, width, 3), PAPER, dtype=np.uint8)
    grey = DARKEST + (BRIGHTEST - DARKEST) * facing[seen]

    def place(places_mm: Array) -> list[list[int]]:
        pixels = np.rint((places_mm @ axes - low) * PX_PER_MM).astype(int) + EDGE_PX
        return [list(map(int, one)) for one in pixels]

    for at, level in zip(place(skin.points_mm[seen]), grey.tolist(), strict=True):
        cv2.circle(picture, at, SKIN_PX, (level, level, level), -1)
    near = (points_mm - skin.points_mm.mean(axis=0)) @ outwards > 0.0
    for at, colour, ring in zip(place(points_mm[near]), colours[near].tolist(), is_ring[near], strict=True):
        if ring:
            cv2.circle(picture, at, radius_px, INK, 1, cv2.LINE_AA)
        else:
            cv2.circle(picture, at, radius_px, colour, -1, cv2.LINE_AA)
    cv2.putText(picture, name, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    return picture
