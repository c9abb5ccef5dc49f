"""Pictures of the skin from the front and both sides: where a scan has covered it, and how the two differ."""

from __future__ import annotations

import numpy as np

from procedures.imaging.drawn_skin import MISSING, SCANNED, Colours, DrawnSkin
from procedures.registration.surface.checks import COVERED_MM, share_covered
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.surface_registration import SurfaceRegistration
from ronna_hw.arrays import Array

COVERAGE_PICTURE, RESIDUALS_PICTURE = "surface-coverage.png", "surface-residuals.png"
RESIDUAL_PX = 3
# Distances of points to the skin of the CT: full blue inside it, full red outside it.
FULL_COLOUR_MM = 1.0
INSIDE, BETWEEN, OUTSIDE = np.array([[190, 90, 20], [225, 225, 225], [30, 40, 200]], dtype=float)  # BGR


def draw_coverage(skin: Surface, points_ct_mm: Array, missing_ct_mm: Array) -> tuple[float, bytes]:
    """Return the covered share of the skin above the jaw, and a PNG picture of it.

    `missing_ct_mm` are places that were planned and are not covered.
    """
    covered = share_covered(points_ct_mm, skin, HeadAxes.of(skin))
    colours = np.repeat([MISSING, SCANNED], (len(missing_ct_mm), len(points_ct_mm)), axis=0)
    places_mm = np.concatenate([missing_ct_mm, points_ct_mm])
    return covered, DrawnSkin(skin.points_mm, skin.normals).draw(places_mm, colours)


def tell_coverage(share: float, placed_by: str) -> str:
    """Say how much of the head points cover, and what has placed them on it."""
    of_head = f"{share:.0%} of the skin above the jaw"
    return f"{of_head} lies within {COVERED_MM:g} mm of a point, placed by {placed_by}"


def draw_residuals(skin: Surface, found: SurfaceRegistration) -> bytes:
    """Return a PNG picture of the registered points, coloured by their distance to the skin."""
    in_ct_mm = np.asarray(found.robot_from_ct.inverse().apply(found.points_mm))
    colours = colour_residuals(found.residuals_mm)
    return DrawnSkin(skin.points_mm, skin.normals).draw(in_ct_mm, colours, found.excluded, RESIDUAL_PX)


def colour_residuals(distances_mm: Array) -> Colours:
    """Return a colour (n, 3) for each distance, positive outside the skin; one that is not known is grey."""
    share = np.clip(np.nan_to_num(distances_mm) / FULL_COLOUR_MM, -1.0, 1.0)[:, None]
    away = np.where(share < 0.0, BETWEEN - INSIDE, OUTSIDE - BETWEEN)
    return np.asarray(BETWEEN + away * share)
