"""Bone registration of two CTs of one head, by coarse-to-fine Gauss-Newton on intensities.

Only bone is compared: HU are clipped at soft tissue and at compact bone, so that swollen skin, air and metal
have little weight; remaining outliers are down-weighted (Cauchy).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.imaging.pose_starts import list_turned_starts
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.postoperative.errors import HEADS_DIFFER, NO_BONE
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import cauchy_weights, robust_sigma

SOFT_HU, COMPACT_HU = 0.0, 1500.0  # below: soft tissue or air; above: compact bone or metal
BONE_HU = 400.0
SPLINE_REACH = 8  # voxels; beyond it a spline barely depends on a value
LEVELS_MM = (4.0, 2.0, 1.0)  # point spacing, twice the standard deviation of the blur
MOST_POINTS = 40_000
MOST_STEPS = 30
STILL_MM, STILL_RAD = 1e-3, 1e-5  # a smaller step changes nothing measurable
START_TURN_RAD = float(np.radians(25.0))  # tried either way about each axis
LEAST_POINTS = 1_000  # of bone at the coarsest level; a skull has ten times as many
LEAST_AGREEMENT = 0.9  # correlation of two scans of the same skull
LEAST_OVERLAP = 0.6  # share of the bone that both scans show


@dataclass(frozen=True, eq=False)
class BoneRegistration:
    """Pose post <- pre of the head in patient coordinates, mm, with quality measures.

    `agreement` is the correlation of bone intensities, 1 for identical skulls; `overlap` is the share of the
    first scan's bone that the second shows; `residual_hu` is the robust standard deviation of the remaining
    difference.
    """

    post_from_pre: RigidTransform
    agreement: float
    overlap: float
    residual_hu: float


@dataclass(frozen=True, eq=False)
class BoneLevel:
    """Scan at one resolution, blurred and subsampled, with values clipped to bone."""

    values: NDArray[np.float32]  # (slices, rows, columns)
    geometry: VoxelGeometry

    def splined(self) -> BoneLevel:
        """Return the level with values turned into spline coefficients, as `interpolate` needs them."""
        return BoneLevel(ndimage.spline_filter(self.values, order=3, output=np.float32), self.geometry)

    def interpolate(self, points_mm: Array) -> tuple[Array, Mask]:
        """Interpolate at patient positions (n, 3) by cubic splines, and flag positions inside the scan."""
        indices = self.geometry.to_index(points_mm).T
        last = np.array(self.geometry.shape)[:, None] - 1.0
        inside = np.all((indices >= 0.0) & (indices <= last), axis=0)
        return ndimage.map_coordinates(self.values, indices, order=3, mode="nearest", prefilter=False), inside


def register_on_bone(pre: Volume, post: Volume) -> BoneRegistration:
    """Register the head in `post` to that in `pre`. Raises POST-001, POST-002."""
    found: RigidTransform | None = None
    middle = np.zeros(3)
    for spacing_mm in LEVELS_MM:
        fixed, moving = build_bone_level(pre, spacing_mm), build_bone_level(post, spacing_mm)
        points, values = find_bone_points(fixed, spacing_mm)
        target = moving.splined()
        if found is None:
            middle = points.mean(axis=0)
            there = find_bone_points(moving, spacing_mm)[0].mean(axis=0)
            few = slice(None, None, max(1, len(points) // LEAST_POINTS))
            tried = [
                refine_on_bone(points[few], values[few], target, start)
                for start in list_turned_starts(middle, there, START_TURN_RAD)
            ]
            found = max(tried, key=lambda one: rate_on_bone(points, values, target, one)[0])
            _require_one_skull(*rate_on_bone(points, values, target, found)[:2])
        else:
            found = refine_on_bone(points, values, target, found)
    assert found is not None
    agreement, overlap, residual_hu = rate_on_bone(points, values, target, found)
    _require_one_skull(agreement, overlap)
    return BoneRegistration(found, agreement, overlap, residual_hu)


def _require_one_skull(agreement: float, overlap: float) -> None:
    """Raise POST-002 unless both scans show the same skull."""
    if overlap < LEAST_OVERLAP or agreement < LEAST_AGREEMENT:
        raise HEADS_DIFFER(
            "the skulls of the two CTs do not match",
            expected=f"agreement of at least {LEAST_AGREEMENT:g} over at least "
            f"{LEAST_OVERLAP:.0%} of the bone",
            got=f"{agreement:.2f} over {overlap:.0%}",
        )


def sample_bone(volume: Volume, places_mm: Array) -> Array:
    """Sample HU at positions (..., 3), clipped to bone. Outside the scan, the value is soft tissue."""
    return np.asarray(np.clip(volume.sample(places_mm, SOFT_HU), SOFT_HU, COMPACT_HU), dtype=float)


def sample_bone_spline(volume: Volume, places_mm: Array) -> Array:
    """Sample HU, clipped to bone, by cubic splines at a few adjacent positions (n, 3) within the scan."""
    index = volume.geometry.to_index(places_mm)
    low = np.clip(np.floor(index.min(axis=0)).astype(int) - SPLINE_REACH, 0, None)
    high = np.ceil(index.max(axis=0)).astype(int) + SPLINE_REACH + 1
    around = volume.voxels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].astype(float)
    values = ndimage.map_coordinates(around, (index - low).T, order=3, mode="constant", cval=SOFT_HU)
    return np.asarray(np.clip(values, SOFT_HU, COMPACT_HU))


def build_bone_level(volume: Volume, spacing_mm: float) -> BoneLevel:
    """Clip to bone, blur by half the spacing, and subsample to about this spacing."""
    geometry = volume.geometry
    strides = np.maximum(1, np.rint(spacing_mm / geometry.spacing_mm)).astype(int)
    values = np.clip(volume.voxels, SOFT_HU, COMPACT_HU).astype(np.float32)
    for axis, (stride, voxel_mm) in enumerate(zip(strides, geometry.spacing_mm, strict=True)):
        if stride > 1:  # one axis at a time, subsampled at once: less to blur
            values = ndimage.gaussian_filter1d(values, 0.5 * spacing_mm / voxel_mm, axis=axis)
            values = values[(slice(None),) * axis + (slice(None, None, int(stride)),)]
    thinned = VoxelGeometry(values.shape, geometry.origin_mm, geometry.axes, geometry.spacing_mm * strides)
    return BoneLevel(values, thinned)


def find_bone_points(level: BoneLevel, spacing_mm: float) -> tuple[Array, Array]:
    """Return voxel centres (n, 3) mm in and around the largest bone component, and their values."""
    labels, count = ndimage.label(level.values > BONE_HU)
    sizes = np.bincount(labels.ravel())[1:] if count else np.zeros(1, dtype=int)
    bone = labels == 1 + int(sizes.argmax())
    around = ndimage.binary_dilation(bone) if count else bone
    index = np.argwhere(around)
    if sizes.max(initial=0) * (spacing_mm / LEVELS_MM[0]) ** 3 < LEAST_POINTS:
        raise NO_BONE("the CT shows no skull", got=f"{sizes.max(initial=0)} voxels of bone in one piece")
    index = index[:: max(1, len(index) // MOST_POINTS)]
    return level.geometry.to_patient_mm(index), level.values[tuple(index.T)].astype(float)


def refine_on_bone(
    points: Array, values: Array, target: BoneLevel, start: RigidTransform, *, rescaled: bool = False
) -> RigidTransform:
    """Refine the pose by Gauss-Newton: rotation about the points' centroid, and translation.

    If the scan of the points has no Hounsfield units, `rescaled` fits a gain and an offset to its values too.
    """
    rotation, shift = start.rotation, start.translation
    middle = points.mean(axis=0)
    arms = points - middle
    centre = rotation.apply(middle) + shift
    gain, offset = 1.0, 0.0
    for _ in range(MOST_STEPS):
        turned = rotation.apply(arms)
        gradient, there, inside = _sample(target, turned + centre)
        if rescaled:
            gain, offset = np.polyfit(values[inside], there[inside], 1).tolist()
        residuals = (there - gain * values - offset)[inside]
        gradient, lever = gradient[inside], turned[inside]
        weights = cauchy_weights(residuals, robust_sigma(residuals) + 1.0)
        jacobian = np.hstack([np.cross(lever, gradient), gradient])
        weighted = jacobian * weights[:, None]
        step = np.linalg.lstsq(weighted.T @ jacobian, -(weighted.T @ residuals), rcond=None)[0]
        rotation = Rotation.from_rotvec(step[:3]) * rotation
        centre = centre + step[3:]
        if np.linalg.norm(step[3:]) < STILL_MM and np.linalg.norm(step[:3]) < STILL_RAD:
            break
    return RigidTransform.from_components(centre - rotation.apply(middle), rotation)


def _sample(target: BoneLevel, points_mm: Array) -> tuple[Array, Array, Mask]:
    """Sample gradients (n, 3) in HU per mm and values (n,), and mark the positions inside the scan."""
    there, inside = target.interpolate(points_mm)
    half_mm = 0.25 * float(target.geometry.spacing_mm.min())
    gradient = np.column_stack(
        [
            (target.interpolate(points_mm + offset)[0] - target.interpolate(points_mm - offset)[0])
            / (2.0 * half_mm)
            for offset in half_mm * np.eye(3)
        ]
    )
    return gradient, there, inside


def rate_on_bone(
    points: Array, values: Array, target: BoneLevel, pose: RigidTransform
) -> tuple[float, float, float]:
    """Return a pose's correlation, overlap and robust residual."""
    there, inside = target.interpolate(pose.apply(points))
    overlap = float(inside.mean())
    if np.count_nonzero(inside) < LEAST_POINTS // 2:
        return 0.0, overlap, float("inf")
    correlation = float(np.corrcoef(there[inside], values[inside])[0, 1])
    residual = robust_sigma(there[inside] - values[inside])
    return correlation, overlap, residual
