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
ON_BONE_MM = 1.5  # of the median of a patch from the skull: a hollow in the skin is not bone
FEWEST_POINTS = 8  # on bone, for it to be looked for in the CT
MOST_TURNS = 12  # of marking and settling; three are usual


@dataclass(frozen=True, eq=False)
class OpenedHead:
    """Skin with a part where the skull takes its place: around the scanned points that lie on bone."""

    skin: Surface
    bone: Surface
    bare_mm: cKDTree

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
        """Return signed distances (n,), normals (n, 3) and which are valid, of skin or bone.

        Around bone the nearer of both is taken: a point at the rim must not change sides as the pose moves.
        """
        distances, normals, valid = self.skin.residuals(points_ct_mm)
        around, _ = self.bare_mm.query(points_ct_mm, distance_upper_bound=PATCH_MM)
        rows = np.flatnonzero(np.isfinite(around))
        if len(rows):
            on_bone = self.bone.residuals(points_ct_mm[rows])
            is_nearer = on_bone[2] & ~(valid[rows] & (np.abs(distances[rows]) <= np.abs(on_bone[0])))
            rows = rows[is_nearer]
            distances[rows], normals[rows], valid[rows] = (one[is_nearer] for one in on_bone)
        return distances, normals, valid


def open_where_bare(
    found: Settled,
    before: Pose,
    points_mm: Array,
    view_mm: Array,
    skin: Surface,
    find_bone: Callable[[], Surface],
) -> tuple[Settled, Surface]:
    """Return the scan settled on skin and bare bone, with that surface; without bare bone, as given.

    `before` is the pose from which it settled: much bone tilts a head that is taken for skin alone so far
    that bone is no longer told from skin there. `find_bone` is called only if enough points lie below the
    skin.
    """
    if np.sum(found.valid & (found.distances_mm < -PATCH_LIMIT_MM)) < FEWEST_POINTS:
        return found, skin
    head = _Head(points_mm, view_mm, skin, find_bone())
    opened = [one for one in map(head.settle, (found.pose, before)) if one is not None]
    return min([(found, skin), *opened], key=lambda one: one[0].capped_mm2)


@dataclass(frozen=True, eq=False)
class _Head:
    """A scan of skin and bone, where nobody has said what is which."""

    points_mm: Array
    view_mm: Array
    skin: Surface
    bone: Surface

    def settle(self, pose: Pose) -> tuple[Settled, Surface] | None:
        """Settle the scan, and find what lies on bone, in turns; None if nothing does in the end."""
        on_bone = np.zeros(len(self.points_mm), dtype=bool)
        for _ in range(MOST_TURNS):
            earlier, on_bone = on_bone, self._mark_bone(pose, np.inf)
            if np.array_equal(on_bone, earlier):
                break
            pose = settle(pose, self.points_mm, self.view_mm, self._open(pose, on_bone)).pose
        on_bone = self._mark_bone(pose, ON_BONE_MM)
        if on_bone.sum() < FEWEST_POINTS:
            return None
        opened = self._open(pose, on_bone)
        return settle(pose, self.points_mm, self.view_mm, opened), opened

    def _open(self, pose: Pose, on_bone: Mask) -> OpenedHead:
        return OpenedHead(self.skin, self.bone, cKDTree(pose.apply(self.points_mm[on_bone])))

    def _mark_bone(self, pose: Pose, limit_mm: float) -> Mask:
        """Mark the points (n,) around which bone is nearer than skin, and nearer than a limit."""
        skin_mm, bone_mm = self._off_mm(pose, self.skin), self._off_mm(pose, self.bone)
        near = cKDTree(pose.apply(self.points_mm)).query_ball_point(pose.apply(self.points_mm), PATCH_MM)
        medians = np.array([(np.median(skin_mm[rows]), np.median(bone_mm[rows])) for rows in near])
        return np.asarray((medians[:, 1] < medians[:, 0]) & (medians[:, 1] < limit_mm))

    def _off_mm(self, pose: Pose, surface: Surface) -> Array:
        found = Settled.at(pose, self.points_mm, self.view_mm, surface)
        return np.where(found.valid, np.abs(found.distances_mm), np.inf)
