"""Skull of the head: its tables under the scalp, as the CT shows them, and their resistance to a drill.

A twist drill resists with its thrust: a part of its edge, and one that grows with feed per revolution and
diameter (Wiggins and Malkin, J. Biomech. 9:553, 1976; Sui and Sugita, Ann. Biomed. Eng. 47:779, 2019). The
sizes are estimates (U) that give 15 N in cortical bone at 0.025 mm per revolution with 3.2 mm, and 2 N in
the diploe.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from sim.world.rigid import Point

SCALP_LAYERS_MM = (1.6, 2.6, 1.5)  # skin, fat, galea and muscle
OUTER_TABLE_MM, DIPLOE_MM, INNER_TABLE_MM = 1.8, 3.2, 1.8
SCALP_MM = sum(SCALP_LAYERS_MM)


class BoneKind(NamedTuple):
    """Resistance of a bone to a drill: by feed and diameter, and of its edge alone."""

    pressure_N_mm2: float  # thrust for half the diameter and each mm of feed per revolution
    edge_N: float


CORTICAL, DIPLOE, NO_BONE = BoneKind(300.0, 3.0), BoneKind(40.0, 0.5), BoneKind(0.0, 0.0)


def depth_below_skin_mm(place_ct_mm: Point, centre_mm: Point, semi_axes_mm: Point) -> float:
    """Return the depth below the head's ellipsoid to first order, as the CT is painted."""
    offsets = [place - centre for place, centre in zip(place_ct_mm, centre_mm, strict=True)]
    squares = [(offset / axis) ** 2 for offset, axis in zip(offsets, semi_axes_mm, strict=True)]
    squared = sum(squares)
    gradient = sqrt(sum(one / axis**2 for one, axis in zip(squares, semi_axes_mm, strict=True)) + 1e-12)
    return (sqrt(squared) - squared) / gradient


class SkullTables(NamedTuple):
    """Depths below the skin where the tables of the skull begin and end."""

    outside_mm: float
    diploe_mm: float
    inner_mm: float
    inside_mm: float

    @classmethod
    def of(cls, thicker_mm: float = 0.0) -> SkullTables:
        """Return the tables of a skull that is thicker than in the CT, or thinner, evenly in each part."""
        thickness_mm = OUTER_TABLE_MM + DIPLOE_MM + INNER_TABLE_MM
        share = max(thickness_mm + thicker_mm, 0.0) / thickness_mm
        diploe_mm = SCALP_MM + share * OUTER_TABLE_MM
        inner_mm = diploe_mm + share * DIPLOE_MM
        return cls(SCALP_MM, diploe_mm, inner_mm, inner_mm + share * INNER_TABLE_MM)

    def bone_at(self, depth_mm: float) -> BoneKind:
        """Return the bone at a depth."""
        if not self.outside_mm <= depth_mm < self.inside_mm:
            return NO_BONE
        return DIPLOE if self.diploe_mm <= depth_mm < self.inner_mm else CORTICAL
