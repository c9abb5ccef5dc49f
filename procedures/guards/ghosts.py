"""Strays that the tracker makes up: where the lines of sight to two different markers cross.

Each of its two sensors knows a marker only as a line. Two markers that both sensors have in one plane give,
besides their own places, up to two crossings where nothing is. A marker that only one sensor sees is not
reported itself and yet takes part in them, so that a half hidden head shows points in no known place.

Such a point is, for one sensor, on the line to one marker and, for the other, on that to another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.planning.line_of_sight import SENSORS_MM

Array = NDArray[np.float64]

LINE_MM = 1.0  # from a line: the tracker's own bias differs between the places by some tenths
OTHER_LINE_MM = 4.0  # to a marker on the arm, which may be known by the arm alone: its mount is off by 3.5 mm
SENSOR_MM = 10.0  # how well the places of the sensors are known: it counts with the way along the line


def ghosts_of(spheres_mm: Array, others_mm: Array, seen_mm: Array) -> NDArray[np.bool_]:
    """Which of the points (m, 3) are crossings of lines to known markers; all in the tracker's frame.

    The lines lead to the spheres (n, 3) and to the other markers (k, 3). Two that lead to others are held to
    what the tracker knows: the wider limit would take too much of the room about the head for crossings.
    """
    markers, head = np.vstack([spheres_mm, others_mm]), len(spheres_mm)
    limits = np.repeat([LINE_MM, OTHER_LINE_MM], [head, len(others_mm)])
    left, right = (_beside_lines_mm(np.array(eye), markers, seen_mm) for eye in SENSORS_MM)
    pairs = (left < limits)[:, :, None] & (right < limits)[:, None, :]  # (m, n + k, n + k)
    pairs[:, head:, head:] = (left[:, head:, None] < LINE_MM) & (right[:, None, head:] < LINE_MM)
    pairs &= ~np.eye(len(markers), dtype=bool)  # both lines to one marker: that is the marker itself
    return np.asarray(pairs.any(axis=(1, 2)))


def _beside_lines_mm(eye_mm: Array, markers_mm: Array, points_mm: Array) -> Array:
    """How far each point (m, 3) is beside a sensor's line to each marker (n, 3), before or behind it.

    What the place of the sensor leaves open is taken off.
    """
    ways = markers_mm - eye_mm
    lengths = np.linalg.norm(ways, axis=1)
    beside = points_mm[:, None] - markers_mm
    along = (beside * (ways / lengths[:, None])).sum(axis=2)
    away = np.sqrt(np.maximum((beside**2).sum(axis=2) - along**2, 0.0))
    return np.asarray(away - SENSOR_MM * np.abs(along) / lengths)
