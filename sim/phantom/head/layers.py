"""The layers of the head: intensity as a function of depth below the skin."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.shapes import Point, Values, ellipsoid_depth

AIR_HU = -1000.0
# thickness in mm and HU, from the skin inwards; the last one fills the rest
LAYERS = (
    (1.6, 35.0),  # skin
    (2.6, -80.0),  # fat
    (1.5, 50.0),  # galea and muscle
    (1.8, 1450.0),  # outer table of the skull
    (3.2, 650.0),  # diploe
    (1.8, 1450.0),  # inner table
    (2.0, 10.0),  # cerebrospinal fluid
    (4.5, 38.0),  # grey matter
    (0.0, 29.0),  # white matter
)
SCALP_MM = sum(thickness for thickness, _ in LAYERS[:3])
STEP_MM = 0.05
OUTSIDE_MM = 4.0
BLUR_MARGIN = 4.0  # of the blur's sigma


class HeadLayers:
    """Looks up intensities. `blur_mm` is the standard deviation by which edges are smoothed, 0 for none."""

    def __init__(self, centre: Point, semi_axes: Point, blur_mm: float) -> None:
        self.centre = centre
        self.semi_axes = semi_axes
        inside_mm = sum(thickness for thickness, _ in LAYERS) + OUTSIDE_MM
        depths = np.arange(-OUTSIDE_MM, inside_mm, STEP_MM)
        table = np.full(len(depths), AIR_HU)
        top = 0.0
        for thickness, hu in LAYERS:
            table[depths >= top] = hu
            top += thickness
        self._table = _smoothed(table, blur_mm / STEP_MM).astype(np.float32)

    def at(self, x: Values, y: Values, z: Values) -> Values:
        """HU at these points; air outside the head."""
        depth = ellipsoid_depth(x, y, z, self.centre, self.semi_axes)
        place = (depth + np.float32(OUTSIDE_MM)) * np.float32(1.0 / STEP_MM) + np.float32(0.5)
        last = np.float32(len(self._table) - 1)
        hu: Values = self._table[np.clip(place, np.float32(0.0), last).astype(np.int32)]
        return hu

    def half_widths(self, z_mm: float, margin_mm: float) -> tuple[float, float] | None:
        """Half extents in x and y of the head's section at `z_mm`, with a margin; None if there is none."""
        a, b, c = (axis + margin_mm for axis in self.semi_axes)
        left = 1.0 - ((z_mm - self.centre[2]) / c) ** 2
        return None if left <= 0.0 else (a * sqrt(left), b * sqrt(left))


def _smoothed(table: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    if sigma <= 0.0:
        return table
    margin = int(np.ceil(BLUR_MARGIN * sigma))
    kernel = np.exp(-0.5 * (np.arange(-margin, margin + 1) / sigma) ** 2)
    padded = np.pad(table, margin, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
