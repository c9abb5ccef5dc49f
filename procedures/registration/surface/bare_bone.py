"""Bone laid bare: a part of the scan lies on the skull, which does not move against the target.

Nobody has to say where the scalp is open: a patch that lies as far below the skin as the skull does is bone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from procedures.registration.surface.settling import PATCH_LIMIT_MM, Pose, Settled, settle
from procedures.registration.surface.surface import Surface
from ronna_hw.arrays import Array, Mask

PATCH_MM = 8.0  # radius over which the points agree that they lie on bone
ON_BONE_MM = 1.5  # of the median of a patch from the skull, while the pose follows from the skin alone
FEWEST_POINTS = 8  # on bone, for it to be looked for in the CT


@dataclass(frozen=True, eq=False)
class OpenedHead:
    """Skin with a part where the skull takes its place: where the nearest scanned point is on bone."""

    skin: Surface
    bone: Surface
    scanned: cKDTree
    on_bone: Mask

    @property
    def points_mm(self) -> Array:
        """Samples (m, 3) of the skin, which say how much of the head was scanned."""
        return self.skin.points_mm

    @property
    def normals(self) -> Array:
        """Outward unit normals (m, 3) of the samples."""
        return self.skin.normals

    @property
    def voxel_mm(self) -> Array:
        """Edges (3, 3) of the voxels, as rows."""
        return self.skin.voxel_mm

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Return signed distances (n,), normals (n, 3) and which are valid, of skin or bone."""
        distances, normals, valid = self.skin.residuals(points_ct_mm)
        _, nearest = self.scanned.query(points_ct_mm)
        rows = np.flatnonzero(self.on_bone[nearest])
        if len(rows):
            distances[rows], normals[rows], valid[rows] = self.bone.residuals(points_ct_mm[rows])
        return distances, normals, valid


def open_where_bare(
    found: Settled, points_mm: Array, view_mm: Array, skin: Surface, find_bone: Callable[[], Surface]
) -> tuple[Settled, Surface]:
    """Return the scan settled on skin and bare bone, with that surface; without bare bone, as given.

    `find_bone` is called only if enough points lie below the skin.
    """
    below = found.valid & (found.distances_mm < -PATCH_LIMIT_MM)
    if below.sum() < FEWEST_POINTS:
        return found, skin
    bone = find_bone()
    on_bone = _mark_bone(found.pose, points_mm, below, bone)
    if on_bone.sum() < FEWEST_POINTS:
        return found, skin
    opened = OpenedHead(skin, bone, cKDTree(found.places_mm), on_bone)
    return settle(found.pose, points_mm, view_mm, opened), opened


def _mark_bone(pose: Pose, points_mm: Array, below: Mask, bone: Surface) -> Mask:
    """Mark the points (n,) below the skin that lie on bone with most of those around them."""
    rows = np.flatnonzero(below)
    places = pose.apply(points_mm[rows])
    distances, _, valid = bone.residuals(places)
    off_mm = np.where(valid, np.abs(distances), np.inf)
    near = cKDTree(places).query_ball_point(places, PATCH_MM)
    marked = np.zeros(len(points_mm), dtype=bool)
    marked[rows] = [float(np.median(off_mm[one])) < ON_BONE_MM for one in near]
    return marked
