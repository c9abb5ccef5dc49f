"""Head of the study as its CT shows it, and the targets in it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from ronna_hw.arrays import Array, Mask
from sim.world.head_surface.face import draw_measures
from sim.world.head_surface.parametric_head import ParametricHead
from studies.surface.conditions import DEPTHS_MM, TARGETS_EACH
from studies.surface.second_judged_skins import Blur

CENTRE_CT_MM = (0.0, 0.0, 0.0)
EDGE_MM = 0.7  # width of the skin's edge in a CT of thin slices: its pixel and its kernel (U)
SPACING_MM = 3.0  # of the samples, nearly
PROJECTIONS = 4
ON_SKIN_MM = 0.01
LOWEST_TARGET = -0.3  # share of the cranium's height: no target below the base of the brain
MOST_TRIES = 5000  # candidates for targets


@dataclass(frozen=True, eq=False)
class HeadInCt:
    """Skin of a parametric head in the CT, whose level is wrong by `offset_mm`; `voxel_mm` (3, 3) its edges.

    Exact otherwise: the study judges the registration, not the finding of the skin in grey values. `skin_mm`
    (m, 3) are samples of the skin itself, `normals` (m, 3) their outward directions.
    """

    head: ParametricHead
    skin_mm: Array
    normals: Array
    offset_mm: float = 0.0
    voxel_mm: Array = field(default_factory=lambda: EDGE_MM * np.eye(3))

    @classmethod
    def sample(cls, head: ParametricHead, spacing_mm: float = SPACING_MM) -> Self:
        """Sample the skin of a head."""
        return cls(head, *_sample_skin(head, spacing_mm))

    def shown_by(self, offset_mm: float, slices: Blur | None) -> Self:
        """Return the same head in a CT that shows its skin outside by an offset, perhaps in thick slices."""
        voxel_mm = self.voxel_mm if slices is None else slices.voxel_mm(EDGE_MM)
        return replace(self, offset_mm=offset_mm, voxel_mm=voxel_mm)

    @property
    def points_mm(self) -> Array:
        """Samples (m, 3) of the skin in the CT."""
        return np.asarray(self.skin_mm + self.offset_mm * self.normals)

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Return signed distances (n,) and normals (n, 3) of points, and which are within the CT."""
        distances = self.head.distance_mm(points_ct_mm) - self.offset_mm
        valid = np.asarray(points_ct_mm[:, 2] > self.head.bounds_mm[0][2])
        return distances, self.head.normals(points_ct_mm), valid

    def targets_mm(self, random: np.random.Generator) -> dict[str, Array]:
        """Draw targets (k, 3) of each depth below the skin, in the brain."""
        semi_axes = np.asarray(self.head.semi_axes_mm)
        tree = cKDTree(self.skin_mm)
        points = random.uniform(-1.0, 1.0, (MOST_TRIES, 3))
        points = points[(np.linalg.norm(points, axis=1) < 1.0) & (points[:, 2] > LOWEST_TARGET)] * semi_axes
        depths, _ = tree.query(points + CENTRE_CT_MM)
        return {
            name: points[(depths >= low) & (depths <= high)][:TARGETS_EACH] + CENTRE_CT_MM
            for name, (low, high) in DEPTHS_MM.items()
        }


@lru_cache(maxsize=2)
def draw_head(seed: int, number: int) -> HeadInCt:
    """Draw head `number` of a study; it is kept, as all conditions have the same heads."""
    measures = draw_measures(np.random.default_rng([seed, number]))
    return HeadInCt.sample(ParametricHead(CENTRE_CT_MM, measures.semi_axes_mm, measures.face))


def _sample_skin(head: ParametricHead, spacing_mm: float) -> tuple[Array, Array]:
    """Return points of a lattice near the skin, projected onto it, and the normals there."""
    low, high = head.bounds_mm
    axes = [np.arange(of, to, spacing_mm).astype(np.float32) for of, to in zip(low, high, strict=True)]
    distances = head.field(axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]).distance()
    near = np.nonzero(np.abs(distances) < 0.5 * spacing_mm)
    points = np.stack([axis[rows] for axis, rows in zip(axes, near, strict=True)], axis=1).astype(float)
    for _ in range(PROJECTIONS):
        points = points - head.distance_mm(points)[:, None] * head.normals(points)
    is_on_skin = (np.abs(head.distance_mm(points)) < ON_SKIN_MM) & (points[:, 2] > low[2])
    return points[is_on_skin], head.normals(points[is_on_skin])
