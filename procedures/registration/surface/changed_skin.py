"""Regions of skin that may have moved by themselves since the CT, and what the adjustment says about them.

Pressed, taped or swollen skin moved over a region with an edge, which no smooth misfit explains. Every region
of a list takes part in the mixture of the adjustment as one that moved by an unknown way, or not (`misfit`).
Nothing is decided before: a region that half explains the scan widens the limits by half.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import expit

from procedures.registration.surface.misfit import Adjustment, MisfitModel, PoseMixture, Roughness
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.settling import Settled
from ronna_hw.arrays import Array, Mask

SIDE_SHARES = (0.2, 1.0 / 3.0, 0.45)  # of the scan, as when the head lay on one side
DISCS_APART_MM = 8.0
DISC_RADII_MM = 12.0 * 1.2 ** np.arange(14)
DISC_EDGE_MM = 2.0  # of the logistic function across its edge: nine tenths of it within six times that
FEWEST_IN_REGION = 6
MOST_REGIONS = 200  # in the adjustment
SCORED = {(Roughness.ROUGH, 40.0), (Roughness.SMOOTH, 20.0)}  # hypotheses, by which these are chosen
# Expected, the chance that it moved counted in; a smaller change is a misfit like any other.
LEAST_CHANGE_MM = 0.2


@dataclass(frozen=True, eq=False)
class ChangedSkin:
    """Skin that is probably not where the CT shows it: its parts by name, its points in the scan.

    `shift_mm` is their mean distance from the skin in the CT, outwards.
    """

    parts: tuple[str, ...]
    shift_mm: float
    points: Mask

    @classmethod
    def of(
        cls, mixture: PoseMixture, regions: Array, settled: Settled, used: Mask, axes: HeadAxes
    ) -> Self | None:
        """Read from an adjustment of some points which of them have moved; it had `regions` (n, g)."""
        count = regions.shape[1] + 1
        ways_mm = np.bincount(mixture.region, mixture.weights * mixture.moved_mm, count)[1:]
        shift_mm = regions @ ways_mm
        moved = np.zeros(len(used), dtype=bool)
        moved[used] = np.abs(shift_mm) > LEAST_CHANGE_MM
        if not moved.any():
            return None
        parts = tuple(sorted(set(axes.name_parts(settled.places_mm[moved]).tolist())))
        return cls(parts, float(settled.distances_mm[moved].mean()), moved)


def list_regions(places_mm: Array, normals: Array, axes: HeadAxes) -> Array:
    """List regions of a scan that may have moved as one, (n, g) by how far a unit of it moves their points.

    Along the normals: parts by name, sides, and discs of all sizes with soft edges. Along each axis of the
    CT: the slices above or below some place, in which a patient who moved during the scan is elsewhere.
    """
    names = axes.name_parts(places_mm)
    groups = [names == one for one in np.unique(names)]
    ways_mm = [sign * along for along in places_mm.T for sign in (1.0, -1.0)]
    groups.extend(way_mm < np.quantile(way_mm, share) for way_mm in ways_mm for share in SIDE_SHARES)
    away_mm = cdist(places_mm, places_mm[_spread(places_mm, DISCS_APART_MM)])
    discs = expit((DISC_RADII_MM[:, None, None] - away_mm) / DISC_EDGE_MM)
    regions = np.column_stack([*groups, *discs]).astype(float)
    counts = regions.sum(axis=0)
    regions = regions[:, (counts >= FEWEST_IN_REGION) & (counts <= len(places_mm) / 2.0)]
    heights_mm = (places_mm[:, 2], -places_mm[:, 2])
    slabs = [one < np.quantile(one, share) for one in heights_mm for share in SIDE_SHARES]
    return np.column_stack([regions, *(slab[:, None] * normals for slab in slabs)])


def likely_regions(model: MisfitModel, jacobian: Array, residuals_mm: Array, regions: Array) -> Array:
    """Return those of the regions (n, g) that explain residuals best, by a few of the hypotheses."""
    if regions.shape[1] <= MOST_REGIONS:
        return regions
    few = model.some(lambda one: (one.roughness, one.length_mm) in SCORED)
    mixture = Adjustment.of(few, jacobian, regions).step(residuals_mm)
    weights = np.bincount(mixture.region, mixture.weights, regions.shape[1] + 1)[1:]
    return regions[:, np.sort(np.argsort(-weights, kind="stable")[:MOST_REGIONS])]


def _spread(places_mm: Array, apart_mm: float) -> list[int]:
    """Return rows of points that are at least this far apart."""
    kept: list[int] = []
    for row, place in enumerate(places_mm):
        if not kept or np.linalg.norm(places_mm[kept] - place, axis=1).min() > apart_mm:
            kept.append(row)
    return kept
