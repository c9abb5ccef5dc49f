"""Robust settling of points on a surface, and the parts of a scan that are not that surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from procedures.registration.surface.surface import Surface
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import cauchy_weights, robust_sigma

MOST_STEPS = 40
STILL_MM, STILL_RAD = 1e-4, 1e-6
LEAST_SIGMA_MM = 0.05  # of the weights: a perfect fit has no scale
FAR_MM = 40.0  # a point further off says nothing at first
NEAR_MM = 6.0  # later: whatever is further off is another body
NEAR_SIGMAS = 4.0
LEAST_POINTS = 12  # twice the unknowns of a pose
RIDGE = 1e-6  # of the mean diagonal: a sphere leaves a turn undetermined, which is refused later

PATCH_MM = 12.0  # radius over which neighbours must agree that they are off
PATCH_LIMIT_MM = 2.0  # skin, even pressed, is nearer; a hand, a drape or hair is not
# Of a single point from its neighbours, and at least: a gloss or a wrong match, not skin
STRAY_SIGMAS, STRAY_LIMIT_MM = 6.0, 0.5
EDGE_MM = 1.0  # points beside a patch that are off by this belong to it


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid pose CT <- robot as rotation (3, 3) and translation (3,) mm."""

    rotation: Array
    translation_mm: Array

    def apply(self, points_mm: Array) -> Array:
        """Map points (n, 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def moved(self, shift: Array, centre_mm: Array) -> Self:
        """Return the pose after a small movement (6,) about a centre in the CT frame."""
        turn = np.asarray(Rotation.from_rotvec(shift[:3]).as_matrix())
        translation = turn @ (self.translation_mm - centre_mm) + centre_mm + shift[3:]
        return type(self)(turn @ self.rotation, translation)


@dataclass(frozen=True, eq=False)
class Settled:
    """Points on a surface at one pose: places, distances (n,), normals (n, 3), and which are valid."""

    pose: Pose
    places_mm: Array
    distances_mm: Array
    normals: Array
    valid: Mask

    @classmethod
    def at(cls, pose: Pose, points_mm: Array, view_mm: Array, surface: Surface) -> Self:
        """Place the points; one whose surface faces away from its view is not valid."""
        places = pose.apply(points_mm)
        distances, normals, valid = surface.residuals(places)
        facing = np.einsum("ni,ni->n", normals, pose.apply(view_mm) - places) > 0.0
        return cls(pose, places, distances, normals, valid & facing)

    @property
    def directions(self) -> Array:
        """Normals (n, 3) in the frame of the points, of the robot."""
        return np.asarray(self.normals @ self.pose.rotation)

    @property
    def sigma_mm(self) -> float:
        """Robust standard deviation of the valid distances."""
        return robust_sigma(self.distances_mm[self.valid]) if self.valid.any() else float("inf")

    @property
    def capped_mm2(self) -> float:
        """Mean square of the distances; far points count as `NEAR_MM`, as do those that are not valid."""
        capped = np.where(self.valid, np.minimum(np.abs(self.distances_mm), NEAR_MM), NEAR_MM)
        return float(np.mean(capped**2))

    def capped_mean_mm2(self, used: Mask) -> float:
        """Mean square of the distances of some points; those of another body count as its limit."""
        distances_mm = np.minimum(np.abs(self.distances_mm[used]), PATCH_LIMIT_MM)
        return float(np.mean(distances_mm**2)) if len(distances_mm) else 0.0

    def on_the_same_parts(self, expected_mm: Array) -> Self:
        """Return the points with the `expected_mm` (n,) for those that came to lie on another part.

        Beside a fold, as of an ear, half a millimetre decides which part is nearest: the distance of such a
        point would jump by millimetres.
        """
        is_elsewhere = ~self.valid | (np.abs(self.distances_mm - expected_mm) > STRAY_LIMIT_MM)
        return replace(self, distances_mm=np.where(is_elsewhere, expected_mm, self.distances_mm))

    def jacobian(self, centre_mm: Array) -> Array:
        """Differentiate the distances by a movement about a centre, (n, 6)."""
        return np.hstack([np.cross(self.places_mm - centre_mm, self.normals), self.normals])


def settle(
    pose: Pose, points_mm: Array, view_mm: Array, surface: Surface, used: Mask | None = None
) -> Settled:
    """Move the points onto the surface from a nearby pose by robust point-to-surface least squares."""
    used = np.ones(len(points_mm), dtype=bool) if used is None else used
    found = Settled.at(pose, points_mm, view_mm, surface)
    gate_mm = FAR_MM
    for _ in range(MOST_STEPS):
        rows = found.valid & used & (np.abs(found.distances_mm) < gate_mm)
        if rows.sum() < LEAST_POINTS:
            break
        distances = found.distances_mm[rows]
        sigma = max(robust_sigma(distances), LEAST_SIGMA_MM)
        gate_mm = max(NEAR_MM, NEAR_SIGMAS * sigma)
        centre = found.places_mm[rows].mean(axis=0)
        jacobian = found.jacobian(centre)[rows]
        weighted = jacobian * cauchy_weights(distances, sigma)[:, None]
        normal = weighted.T @ jacobian
        normal[np.diag_indices(6)] *= 1.0 + RIDGE
        shift = np.asarray(-np.linalg.lstsq(normal, weighted.T @ distances, rcond=None)[0], dtype=float)
        found = Settled.at(found.pose.moved(shift, centre), points_mm, view_mm, surface)
        if np.linalg.norm(shift[3:]) < STILL_MM and np.linalg.norm(shift[:3]) < STILL_RAD:
            break
    return found


def mark_other_bodies(found: Settled) -> Mask:
    """Mark points (n,) that are not the head's surface: contiguous patches off it, and single far ones."""
    tree = cKDTree(found.places_mm)
    distances = np.where(found.valid, found.distances_mm, np.nan)
    near = tree.query_ball_point(found.places_mm, PATCH_MM)
    level = np.array([np.nanmedian(distances[rows]) if found.valid[rows].any() else np.inf for rows in near])
    patch = (np.abs(level) > PATCH_LIMIT_MM) & (np.abs(found.distances_mm) > EDGE_MM)
    grown = np.array([patch[rows].any() for rows in near]) & (np.abs(found.distances_mm) > EDGE_MM)
    beside = np.abs(found.distances_mm - level)
    usual = robust_sigma(beside[np.isfinite(beside)]) if np.isfinite(beside).any() else 0.0
    stray = beside > max(STRAY_SIGMAS * usual, STRAY_LIMIT_MM)
    return np.asarray(patch | grown | stray | ~found.valid | (np.abs(found.distances_mm) > NEAR_MM))
