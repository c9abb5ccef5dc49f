"""Search for the pose of a scan by the scan alone.

Orientations are spread evenly, and all are moved towards the surface at once. The sample of the surface that
is nearest to a place is looked up in a grid: all poses together need a hundred thousand of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from procedures.registration.surface.errors import LITTLE_COVERAGE, TWO_POSES
from procedures.registration.surface.settling import Pose, Settled, settle
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

SEARCH_POINTS, SEARCH_SAMPLES = 80, 3000
ORIENTATIONS = 400  # about 30 degrees apart
STAGES = ((5, 60), (15, 6))  # steps towards the surface, and poses that are kept then
OVERLAP = 0.8  # share of the scan that is taken as the head's
SEEN = 0.35  # cosine between a normal and the view, from which a surface is scanned
VIEWS_MM = 50.0  # nearer places of a projector are one view
COARSER = 4  # of the samples, for their middle
CELL_MM, ROOM_MM = 5.0, 30.0  # of the grid of nearest samples, and around them
FAR_MM = 30.0  # distance that counts for farther points, and for those on a side that no view sees
DAMPING = 0.02  # of the steps, relative to one of all points at `ARM_MM`: a sphere leaves turns undetermined
ARM_MM = 50.0
SAME_TURN_RAD, SAME_PLACE_MM = np.radians(8.0), 8.0  # closer poses are one
CLEARLY_WORSE_MM2 = 0.25  # of the mean square of another pose above that of the best: half a millimetre
SUPER_GOLDEN = 1.533751168755204288118041  # of Alexa 2022, Super-Fibonacci spirals: psi^4 = psi + 4


def find_pose(points_mm: Array, view_mm: Array, surface: Surface, same_head_mm: float) -> Settled:
    """Find the pose by the scan alone. Raises SRF-002 if none fits, SRF-004 if several do.

    In each orientation the parts that the scan's views would see are put together, and trimmed steps from
    points to planes rank them. The best are settled on the surface. If none has a residual below
    `same_head_mm`, the best is returned for the caller to refuse.
    """
    rows = thin_points(points_mm, SEARCH_POINTS)
    points, view = points_mm[rows], view_mm[rows]
    samples = _Samples.of(surface)
    poses = _Poses.spread(points, view, samples)
    for steps, kept in STAGES:
        poses, residuals_mm = poses.approach(points, view, samples, steps)
        best = np.argsort(residuals_mm, kind="stable").tolist()
        if (steps, kept) == STAGES[-1]:
            best = poses.distinct(best, points.mean(axis=0))
        poses = poses.select(best[:kept])
    settled = [settle(one, points, view, surface) for one in poses.split()]
    settled = sorted((one for one in settled if one.valid.mean() > 0.5), key=lambda one: one.capped_mm2)
    if not settled:
        raise LITTLE_COVERAGE("no pose puts the scan on the head", got=format_count(len(points), "point"))
    first = settled[0]
    for other in settled[1:]:
        turn, place = difference(first.pose, other.pose, points.mean(axis=0))
        alike = other.capped_mm2 < first.capped_mm2 + CLEARLY_WORSE_MM2
        if first.sigma_mm < same_head_mm and alike and (turn > SAME_TURN_RAD or place > SAME_PLACE_MM):
            raise TWO_POSES(
                "two poses fit the scan about equally",
                got=f"{first.capped_mm2**0.5:.2f} and {other.capped_mm2**0.5:.2f} mm rms, "
                f"{np.degrees(turn):.0f} deg and {place:.0f} mm apart",
            )
    return first


def difference(one: Pose, other: Pose, at_mm: Array) -> tuple[float, float]:
    """Return turn, rad, and distance, mm, between two poses at a point (3,) of the robot frame."""
    turn = Rotation.from_matrix(one.rotation @ other.rotation.T).magnitude()
    shift = one.apply(at_mm[None]) - other.apply(at_mm[None])
    return float(turn), float(np.linalg.norm(shift))


@cache
def spread_rotations(count: int) -> Array:
    """Return rotations (count, 3, 3) spread evenly (Alexa 2022, super-Fibonacci spirals)."""
    share = (np.arange(count) + 0.5) / count
    alpha = 2.0 * np.pi * (np.arange(count) + 0.5) / 2.0**0.5
    beta = 2.0 * np.pi * (np.arange(count) + 0.5) / SUPER_GOLDEN
    inner, outer = np.sqrt(share), np.sqrt(1.0 - share)
    quaternions = [inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)]
    return np.asarray(Rotation.from_quat(np.column_stack(quaternions)).as_matrix())


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples (m, 3) of a surface with normals, and the number of the nearest one in each cell of a grid."""

    points_mm: Array
    normals: Array
    lowest_mm: Array
    nearest: NDArray[np.int64]

    @classmethod
    def of(cls, surface: Surface) -> Self:
        """Take some of a surface's samples."""
        every = max(1, len(surface.points_mm) // SEARCH_SAMPLES)
        points = surface.points_mm[::every]
        lowest = points.min(axis=0) - ROOM_MM
        owner = np.full(np.ceil((points.max(axis=0) + ROOM_MM - lowest) / CELL_MM).astype(int) + 1, -1)
        owner[tuple(((points - lowest) / CELL_MM).astype(int).T)] = np.arange(len(points))
        cells = ndimage.distance_transform_edt(owner < 0, return_distances=False, return_indices=True)
        return cls(points, surface.normals[::every], lowest, owner[tuple(cells)])

    def find(self, places_mm: Array) -> NDArray[np.int64]:
        """Return the numbers (...) of the samples about nearest to places (..., 3)."""
        cells = ((places_mm - self.lowest_mm) / CELL_MM).astype(np.int64)
        cells = np.clip(cells, 0, np.array(self.nearest.shape) - 1)
        return np.asarray(self.nearest[tuple(np.moveaxis(cells, -1, 0))])


@dataclass(frozen=True, eq=False)
class _Poses:
    """Poses CT <- robot: rotations (k, 3, 3) and translations (k, 3)."""

    rotations: Array
    translations_mm: Array

    @classmethod
    def spread(cls, points: Array, view: Array, samples: _Samples) -> Self:
        """Return evenly spread poses that put the scan onto the side that its views would see."""
        rotations = spread_rotations(ORIENTATIONS)
        looks = np.unique(np.round(view / VIEWS_MM), axis=0) * VIEWS_MM - points.mean(axis=0)
        looks /= np.linalg.norm(looks, axis=1, keepdims=True)
        places, normals = samples.points_mm[::COARSER], samples.normals[::COARSER]
        seen = np.max(np.einsum("mi,rij,lj->rml", normals, rotations, looks), axis=2) > SEEN
        middle = (seen @ places) / np.maximum(seen.sum(axis=1), 1)[:, None]
        return cls(rotations, middle - rotations @ points.mean(axis=0))

    def approach(self, points: Array, view: Array, samples: _Samples, steps: int) -> tuple[Self, Array]:
        """Step all poses towards the samples; return them with rms distances (k,) of the nearer points."""
        poses, kept = self, round(OVERLAP * len(points))
        for step in range(steps + 1):
            placed = poses.apply(points)
            near = samples.find(placed)
            normals, gaps = samples.normals[near], placed - samples.points_mm[near]
            faces = np.einsum("kni,kni->kn", poses.apply(view) - placed, normals) > 0.0
            distances = np.where(faces, np.minimum(np.linalg.norm(gaps, axis=2), FAR_MM), FAR_MM)
            limit = np.partition(distances, kept - 1, axis=1)[:, kept - 1 : kept]
            used = (distances <= limit).astype(float)
            residuals = np.sqrt((used * distances**2).sum(axis=1) / used.sum(axis=1))
            if step < steps:
                along = np.einsum("kni,kni->kn", gaps, normals)
                poses = poses._stepped(placed, normals, along, used)
        return poses, residuals

    def _stepped(self, placed: Array, normals: Array, along: Array, used: Array) -> Self:
        """Return the poses after a damped step from points to planes."""
        centre = placed.mean(axis=1)
        jacobian = np.concatenate([np.cross(placed - centre[:, None], normals), normals], axis=2)
        weighted = np.swapaxes(jacobian * used[:, :, None], 1, 2)
        normal = weighted @ jacobian
        damping = DAMPING * used.sum(axis=1)[:, None] * np.repeat([ARM_MM**2, 1.0], 3)
        normal[:, range(6), range(6)] += damping
        shift = -np.linalg.solve(normal, weighted @ along[:, :, None])[:, :, 0]
        turn = np.asarray(Rotation.from_rotvec(shift[:, :3]).as_matrix())
        about = np.einsum("kij,kj->ki", turn, self.translations_mm - centre)
        return type(self)(turn @ self.rotations, about + centre + shift[:, 3:])

    def apply(self, points_mm: Array) -> Array:
        """Map points (n, 3) by each pose, (k, n, 3)."""
        return np.asarray(points_mm @ np.swapaxes(self.rotations, 1, 2) + self.translations_mm[:, None])

    def select(self, rows: list[int]) -> Self:
        """Return some of the poses."""
        return type(self)(self.rotations[rows], self.translations_mm[rows])

    def split(self) -> list[Pose]:
        """Return the poses one by one."""
        return [Pose(*one) for one in zip(self.rotations, self.translations_mm, strict=True)]

    def distinct(self, order: list[int], at_mm: Array) -> list[int]:
        """Drop poses that nearly repeat a better one; `order` lists the best first."""
        poses, kept = self.split(), list[int]()
        for row in order:
            apart = (difference(poses[row], poses[one], at_mm) for one in kept)
            if all(turn > SAME_TURN_RAD or place > SAME_PLACE_MM for turn, place in apart):
                kept.append(row)
        return kept
