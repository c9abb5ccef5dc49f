"""Phantom markers: intersections of the rays of different markers.

Stereo matching cannot distinguish two markers in one epipolar plane: it finds up to two positions
besides the true ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.polaris.optics.marker_noise import in_field

Vectors = NDArray[np.float64]
Flags = NDArray[np.bool_]


def phantoms(eyes_mm: Vectors, points_mm: Vectors, seen: Flags, line_separation_mm: float) -> Vectors:
    """The phantoms (m, 3) of markers at `points_mm` (n, 3); `seen` (2, n) per sensor and marker.

    Rays closer than `line_separation_mm` intersect, midway between them.
    """
    left, right = np.nonzero(seen[0])[0], np.nonzero(seen[1])[0]
    if line_separation_mm <= 0.0 or len(left) < 1 or len(right) < 1:
        return np.empty((0, 3))
    first, second = (pairs.ravel() for pairs in np.meshgrid(left, right, indexing="ij"))
    different = first != second
    first, second = first[different], second[different]
    a, b = points_mm[first] - eyes_mm[0], points_mm[second] - eyes_mm[1]
    base = eyes_mm[0] - eyes_mm[1]
    # Ray parameters at closest approach; nearly parallel rays do not intersect within the field of view.
    aa, bb, ab = ((u * v).sum(axis=1) for u, v in ((a, a), (b, b), (a, b)))
    ad, bd = a @ base, b @ base
    determinant = aa * bb - ab * ab
    apart = determinant > 1e-9 * aa * bb
    determinant = np.where(apart, determinant, 1.0)
    on_a = base / 2.0 + ((ab * bd - bb * ad) / determinant)[:, None] * a
    on_b = -base / 2.0 + ((aa * bd - ab * ad) / determinant)[:, None] * b
    gap = on_a - on_b
    meet = apart & ((gap * gap).sum(axis=1) <= line_separation_mm**2)
    middle = (eyes_mm[0] + eyes_mm[1]) / 2.0 + (on_a[meet] + on_b[meet]) / 2.0
    found: Vectors = middle[in_field(middle)]
    return found
