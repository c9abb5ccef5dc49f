"""Comparison of two scans of one head: where the skin moved, and whether the head did.

Both are compared through the surface in the CT: what it misses is the same in both and cancels.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from procedures.registration.points import validate_targets
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.surface.changed_skin import ChangedSkin, list_regions
from procedures.registration.surface.errors import SCANS_APART
from procedures.registration.surface.misfit import (
    MISFITS,
    POSE,
    Adjustment,
    MisfitModel,
    PoseMixture,
    Roughness,
)
from procedures.registration.surface.prediction import SurfacePrediction
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.settling import NEAR_MM, Pose, Settled
from procedures.registration.surface.surface import Surface, level_errors_mm
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import Frame, Transform

LARGEST_MISFIT_MM = 0.2  # between two scans that share what they miss of the CT (U)
KINDS = ((Roughness.ROUGH, 40.0), (Roughness.SMOOTH, 20.0))  # two suffice where little differs
ALIKE = tuple(
    one for one in MISFITS if (one.roughness, one.length_mm) in KINDS and one.size_mm <= LARGEST_MISFIT_MM
)
COMMON_MM = 8.0  # from a point of the second scan to those of the first
LEAST_COMMON = 30  # points: five for each unknown of a movement
NEIGHBOURS = 6
MOST_STEPS, STILL = 5, 0.02  # mm and rad: a smaller step changes nothing here


@dataclass(frozen=True, eq=False)
class ScanComparison:
    """Movement of the head from the first scan to the second, and the skin that moved beyond it.

    `common` is the share of the second scan that the first shows too.
    """

    changed: ChangedSkin | None
    common: float
    centre_ct_mm: Array
    robot_from_ct: Transform
    mixture: PoseMixture = field(repr=False)

    @property
    def moved_robot_from_ct(self) -> Transform:
        """Pose robot <- CT of the head as the second scan found it."""
        matrix = self.robot_from_ct.inverse().as_matrix()
        pose = Pose(matrix[:3, :3], matrix[:3, 3]).moved(self.mixture.mean, self.centre_ct_mm)
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = pose.rotation, pose.translation_mm
        return Transform.from_matrix(Frame.CT, Frame.ROBOT, moved).inverse()

    def movement_at(self, target_ct_mm: ArrayLike) -> tuple[Array, SurfacePrediction]:
        """Return how far a target moved, (3,) mm in the robot frame, and its error. Raises REG-001."""
        target = validate_targets(target_ct_mm)[0]
        slope = -self.robot_from_ct.rotation_matrix @ pose_jacobian(target, self.centre_ct_mm)
        mean = self.mixture.mean
        covariances = slope @ self.mixture.covariances @ slope.T
        error = SurfacePrediction(self.mixture.weights, (self.mixture.shifts - mean) @ slope.T, covariances)
        return slope @ mean, error


def compare_scans(
    first: SurfaceScan,
    second: SurfaceScan,
    surface: Surface,
    robot_from_ct: Transform,
    look_mm: float = 0.0,
) -> ScanComparison:
    """Compare two scans of one head, registered by the first. Raises SRF-011 if they share too little.

    `look_mm` is the standard deviation per axis of what the points of one look share, by the arm.
    """
    matrix = robot_from_ct.inverse().as_matrix()
    pose, axes = Pose(matrix[:3, :3], matrix[:3, 3]), HeadAxes.of(surface)
    before = Settled.at(pose, first.points_mm, first.view_mm, surface)
    kept = before.valid & (np.abs(before.distances_mm) < NEAR_MM)
    rows = thin_points(second.points_mm)
    thin = second.select(rows)
    looks = np.unique(thin.look)[None, :, None] == thin.look[:, None, None]
    both_mm = np.sqrt(2.0) * look_mm  # of a look in either scan
    centre, moved = pose.apply(thin.points_mm).mean(axis=0), np.zeros(POSE)
    for step in range(MOST_STEPS):
        after = Settled.at(pose.moved(moved, centre), thin.points_mm, thin.view_mm, surface)
        usual, noise_mm2, used = _read_before(before, first, kept, after)
        used &= after.valid & (np.abs(after.distances_mm) < NEAR_MM)
        if used.sum() < LEAST_COMMON:
            raise SCANS_APART(
                "the scans share too little", limit=f"{LEAST_COMMON} points", got=f"{used.sum()}"
            )
        own_noise = thin.noise_along_mm2(after.directions) + noise_mm2
        shared_mm = (both_mm * looks * (after.normals @ pose.rotation)[:, None, :]).reshape(len(thin), -1)
        places, normals = after.places_mm[used], after.normals[used]
        regions, level_mm = list_regions(places, normals, axes), level_errors_mm(normals, surface.voxel_mm)
        model = MisfitModel.of(places, normals, own_noise[used], shared_mm[used], level_mm, ALIKE)
        adjustment = Adjustment.of(model, after.jacobian(centre)[used], regions)
        beyond_mm = after.distances_mm - usual
        mixture = adjustment.step(beyond_mm[used])
        if np.abs(mixture.mean).max() < STILL or step == MOST_STEPS - 1:
            break
        moved = moved + mixture.mean
    difference = Settled(after.pose, after.places_mm, beyond_mm, after.normals, after.valid)
    changed = ChangedSkin.of(mixture, regions, difference, used, axes)
    mixture = replace(mixture, shifts=mixture.shifts + moved).likely()
    return ScanComparison(changed, float(used.mean()), centre, robot_from_ct, mixture)


def _read_before(
    before: Settled, first: SurfaceScan, kept: Mask, after: Settled
) -> tuple[Array, Array, Mask]:
    """Return the first scan's mean distance around points of the second, its noise, and where it is."""
    places, distances = before.places_mm[kept], before.distances_mm[kept]
    noise = first.noise_along_mm2(before.directions)[kept]
    apart, near = cKDTree(places).query(after.places_mm, k=NEIGHBOURS, distance_upper_bound=COMMON_MM)
    there = np.isfinite(apart)
    near = np.where(there, near, 0)
    weight = there / (1.0 + np.where(there, apart, 0.0) ** 2)  # per mm2: the nearest say most
    total = np.where(there.any(axis=1), weight.sum(axis=1), 1.0)
    mean = (weight * distances[near]).sum(axis=1) / total
    variance = (weight**2 * noise[near]).sum(axis=1) / total**2
    return mean, variance, np.asarray(there.any(axis=1))
