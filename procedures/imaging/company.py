"""What neighbouring bodies in a scan imply about one: overlaps, rows of beads, spheres of another size.

Two whole spheres do not overlap, markers are not lined up like beads, and the markers of one scan are the
same product, all of one size.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.doubts import Doubt

Array = NDArray[np.float64]

OVERLAP = 0.95  # of the diameter: the centres of two spheres cannot be closer
IN_A_ROW = 1.5  # of the diameter: bodies farther apart do not form a row
STRAIGHT_COSINE = -np.cos(np.radians(15.0))  # between the directions to the two neighbours
EVEN_SPACING = 0.15  # of the spacing
FEWEST_ALIKE = 3  # markers needed to establish the usual size
RADIUS_DIFFERENCE = 0.035  # of the radius, at even odds: 0.2 mm
CERTAIN = 3.0  # excess of an impossibility


def company_doubts(centres_mm: Array, others_mm: Array, diameter_mm: float) -> list[tuple[Doubt, ...]]:
    """Doubts about each sphere at `centres_mm` (n, 3), from bodies of similar size at `others_mm` (m, 3)."""
    bodies = np.vstack([centres_mm.reshape(-1, 3), others_mm.reshape(-1, 3)])
    ways = bodies[None] - bodies[:, None]
    distances = np.linalg.norm(ways, axis=2)
    np.fill_diagonal(distances, np.inf)
    beads = _in_rows(ways, distances, diameter_mm)
    doubts: list[tuple[Doubt, ...]] = []
    for number in range(len(centres_mm)):
        found = []
        if distances[number].min(initial=np.inf) < OVERLAP * diameter_mm:
            found.append(Doubt("overlaps another body of its size", CERTAIN))
        if number in beads:
            found.append(Doubt("is one of a row", CERTAIN))
        doubts.append(tuple(found))
    return doubts


def size_doubts(radii_mm: Array, clear: NDArray[np.bool_]) -> list[Doubt]:
    """How far each radius (n,) is from the usual one among those that are clear."""
    if clear.sum() < FEWEST_ALIKE:
        return [Doubt("", 0.0)] * len(radii_mm)
    usual_mm = float(np.median(radii_mm[clear]))
    return [
        Doubt(
            f"has radius {radius_mm:.2f} mm, the others {usual_mm:.2f}",
            abs(radius_mm - usual_mm) / (RADIUS_DIFFERENCE * usual_mm),
        )
        for radius_mm in radii_mm.tolist()
    ]


def _in_rows(ways: Array, distances: Array, diameter_mm: float) -> set[int]:
    """Bodies that belong to three in a line, close together and evenly spaced."""
    near = distances < IN_A_ROW * diameter_mm
    beads: set[int] = set()
    for middle in np.flatnonzero(near.sum(axis=1) >= 2).tolist():
        for one, other in permutations(np.flatnonzero(near[middle]).tolist(), 2):
            lengths = distances[middle, [one, other]]
            straight = ways[middle, one] @ ways[middle, other] < STRAIGHT_COSINE * lengths.prod()
            if straight and np.ptp(lengths) < EVEN_SPACING * lengths.max():
                beads |= {one, middle, other}
    return beads
