"""Denavit-Hartenberg parameters of a true arm, as its factory would measure them.

Between two nearly parallel axes the common normal lies where they happen to come closest, possibly hundreds
of metres away: an arm without visible error may have such parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

PARALLEL = 1e-12  # sine between two axes below which any normal is common


class Row(NamedTuple):
    """Parameters of a joint: Rz(theta + q) Tz(d) Tx(a) Rx(alpha)."""

    theta_rad: float
    d_mm: float
    a_mm: float
    alpha_rad: float


def rows_of_axes(axes: Sequence[tuple[Matrix, Matrix]], flange: Matrix) -> list[Row]:
    """Return the parameters of the joints whose axes are (point mm, direction) in the base at joint zero.

    The first axis is the base's z. The last row has no a and no alpha: it places `flange` (4, 4) along and
    about the last axis only, as far as a row can.
    """
    rows = []
    point, z, x = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    for other, direction in axes[1:]:
        across = np.cross(z, direction)
        sine = float(np.linalg.norm(across))
        gap = other - point
        if sine < PARALLEL:
            d = 0.0
            across = gap - (gap @ z) * z
        else:
            d = float(np.cross(gap, direction) @ across) / sine**2
        normal = across / np.linalg.norm(across)
        if normal @ x < 0.0 and sine >= PARALLEL:
            normal = -normal
        foot = point + d * z
        a = float((other - foot) @ normal)
        theta = atan2(float(np.cross(x, normal) @ z), float(x @ normal))
        alpha = atan2(float(np.cross(z, direction) @ normal), float(z @ direction))
        rows.append(Row(theta, d, a, alpha))
        point, z, x = foot + a * normal, direction, normal
    d = float((flange[:3, 3] - point) @ z)
    theta = atan2(float(np.cross(x, flange[:3, 0]) @ z), float(x @ flange[:3, 0]))
    return [*rows, Row(theta, d, 0.0, 0.0)]
