"""Strays that the tracker makes up: where the lines of sight to two different markers cross.

Each of its two sensors knows a marker only as a line. Two markers that both sensors have in one plane give,
besides their own places, up to two crossings where nothing is. A marker that only one sensor sees is not
reported itself and yet takes part in them, so that a half hidden head shows points in no known place.

Such a point is, for one sensor, on the line to one marker and, for the other, on that to another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.planning.sight.tracker import SENSORS_MM

Array = NDArray[np.float64]

LINE_MM = 1.0  # from a line: the tracker's own bias differs between the places by some tenths
OTHER_LINE_MM = 4.0  # to a marker on the arm, which may be known by the arm alone: its mount is off by 3.5 mm
SENSOR_MM = 10.0  # how well the places of the sensors are known: it counts with the way along the line


def ghosts_of(spheres_mm: Array, others_mm: Array, seen_mm: Array) -> NDArray[np.bool_]:
    """Which of the points (m, 3) are crossings of lines to known markers; all in the tracker's frame.

    One of the two lines at least leads to one of the spheres (n, 3), the other to one of these or of the
    other markers (k, 3).
    """
    markers = np.vstack([spheres_mm, others_mm])
    limits = np.repeat([LINE_MM, OTHER_LINE_MM], [len(spheres_mm), len(others_mm)])
    left, right = (_on_lines(np.array(eye), markers, limits, seen_mm) for eye in SENSORS_MM)
    pairs = left[:, :, None] & right[:, None, :]  # (m, n + k, n + k)
    pairs &= ~np.eye(len(markers), dtype=bool)  # both lines to one marker: that is the marker itself
    pairs[:, len(spheres_mm) :, len(spheres_mm) :] = False
    return np.asarray(pairs.any(axis=(1, 2)))


def _on_lines(eye_mm: Array, markers_mm: Array, limits_mm: Array, points_mm: Array) -> NDArray[np.bool_]:
    """Whether each point (m, 3) is on the line of a sensor to each marker (n, 3), before or behind it."""
    ways = markers_mm - eye_mm
    lengths = np.linalg.norm(ways, axis=1)
    beside = points_mm[:, None] - markers_mm
    along = (beside * (ways / lengths[:, None])).sum(axis=2)
    away = np.sqrt(np.maximum((beside**2).sum(axis=2) - along**2, 0.0))
    return np.asarray(away < limits_mm + SENSOR_MM * np.abs(along) / lengths)
