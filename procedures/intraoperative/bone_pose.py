"""Pose of a truncated cone-beam scan in the planning CT by bone alone, with a covariance from its parts.

The bone of the scan is registered to the CT, not the other way round: the CT shows all that the smaller
field shows. Values of a cone-beam scan are no Hounsfield units, so a gain and an offset are fitted too. Bone
next to the end of the field is not used. Opposite halves of the bone, registered alone, show the error of
the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.imaging.pose_starts import measure_apart_mm
from procedures.imaging.volume import OUTSIDE_FIELD_HU, Volume
from procedures.intraoperative.errors import OTHER_HEAD
from procedures.intraoperative.starts import list_starts
from procedures.postoperative.bone_registration import (
    LEAST_POINTS,
    LEVELS_MM,
    BoneLevel,
    build_bone_level,
    find_bone_points,
    rate_on_bone,
    refine_on_bone,
)
from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

POINTS_OF_START = 1_500
# Safety against a scan of another head (U).
LEAST_AGREEMENT = 0.9  # correlation of the bone of both scans at the coarsest level, where noise is blurred
LEAST_OVERLAP = 0.9  # share of the scan's bone that the CT shows
SAME_POSE_MM = 2.0  # rms over the bone: starts that end closer together found one pose
FEWEST_AGREEING = 3  # starts

CLEAR_STEPS = 3  # of a level's spacing, from the end of the field and from metal
METAL_HU = 1800  # denser than any bone
PART_DIRECTIONS = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)], dtype=float
)
MOST_POINTS_OF_PART = 4_000
# What all parts have in common and hence do not show, per axis: blur of both scans, interpolation. (U)
COMMON_MM, COMMON_RAD = 0.03, 0.0004


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Pose CT <- scan with covariance (6, 6) of a small rotation (rad) about `middle_mm`, then a shift (mm).

    All are in the frame of the CT.
    """

    ct_from_scan: RigidTransform
    middle_mm: Array
    covariance: Array

    def covariances_mm2(self, points_mm: Array) -> Array:
        """Return the covariance (n, 3, 3) mm2 of points (n, 3) mm that the pose carries into the CT."""
        by_pose = pose_jacobian(points_mm, self.middle_mm)
        return np.asarray(by_pose @ self.covariance @ by_pose.transpose(0, 2, 1))

    def moved(self, step: Array, covariance: Array) -> PoseEstimate:
        """Return the pose after a small rotation and shift (6,), with another covariance."""
        turn = Rotation.from_rotvec(step[:3])
        shift = self.middle_mm + step[3:] - turn.apply(self.middle_mm)
        correction = RigidTransform.from_components(shift, turn)
        return PoseEstimate(correction * self.ct_from_scan, self.middle_mm, covariance)


@dataclass(frozen=True, eq=False)
class BonePose:
    """Pose by bone alone, and the evidence for it."""

    pose: PoseEstimate
    agreement: float  # correlation of the bone of both scans at the finest level, which noise lowers
    starts: int
    agreeing_starts: int


def register_bone(
    ct: Volume, scan: Volume, progress: Callable[[float], None] = lambda share: None
) -> BonePose:
    """Register the bone of a scan to the CT. Raises CBCT-004, POST-001."""
    ends: list[tuple[float, RigidTransform]] = []
    found = RigidTransform.identity()
    for number, spacing_mm in enumerate(LEVELS_MM):
        moving, target = build_bone_level(scan, spacing_mm), build_bone_level(ct, spacing_mm)
        points, values = _keep_clear(scan, *find_bone_points(moving, spacing_mm), spacing_mm)
        if len(points) < LEAST_POINTS:
            raise OTHER_HEAD(
                "the scan shows too little bone",
                got=f"{format_count(len(points), 'point')} at {spacing_mm:g} mm",
            )
        splined = target.splined()
        if number == 0:
            ends = _search_starts(points, values, splined, list_starts(ct, scan))
            found = ends[0][1]
            _require_one_skull(*rate_on_bone(points, values, splined, found)[:2])
        else:
            found = refine_on_bone(points, values, splined, found, rescaled=True)
        progress((number + 1) / (len(LEVELS_MM) + 1))
    agreement = rate_on_bone(points, values, splined, found)[0]
    apart_mm = [measure_apart_mm(ends[0][1], one, points) for _, one in ends]
    agreeing = sum(apart <= SAME_POSE_MM for apart in apart_mm)
    if agreeing < FEWEST_AGREEING:
        raise OTHER_HEAD(
            "too few starts led to the best place of the scan",
            expected=f"at least {FEWEST_AGREEING} of {len(ends)}",
            got=str(agreeing),
        )
    pose = _estimate_error(points, values, splined, found)
    progress(1.0)
    return BonePose(pose, agreement, len(ends), agreeing)


def _search_starts(
    points: Array, values: Array, target: BoneLevel, starts: Sequence[RigidTransform]
) -> list[tuple[float, RigidTransform]]:
    """Refine every start with few points; return agreements and poses, the best first."""
    few = slice(None, None, max(1, len(points) // POINTS_OF_START))
    tried = [refine_on_bone(points[few], values[few], target, start, rescaled=True) for start in starts]
    rated = [(_rate(points, values, target, one), one) for one in tried]
    return sorted(rated, key=lambda one: -one[0])


def _rate(points: Array, values: Array, target: BoneLevel, pose: RigidTransform) -> float:
    agreement, overlap, _ = rate_on_bone(points, values, target, pose)
    return agreement if overlap >= LEAST_OVERLAP else 0.0


def _keep_clear(scan: Volume, points: Array, values: Array, spacing_mm: float) -> tuple[Array, Array]:
    """Keep the points whose neighbourhood is scanned and free of metal, which the CT does not show there."""
    kept = np.ones(len(points), dtype=bool)
    for steps in range(CLEAR_STEPS + 1):
        for offset in steps * spacing_mm * np.vstack([np.eye(3), -np.eye(3)]):
            index = np.rint(scan.geometry.to_index(points + offset)).astype(int)
            inside = ((index >= 0) & (index < scan.geometry.shape)).all(axis=1)
            index[~inside] = 0
            here = scan.voxels[tuple(index.T)]
            kept &= inside & (here > OUTSIDE_FIELD_HU) & (here < METAL_HU)
    return points[kept], values[kept]


def _estimate_error(points: Array, values: Array, target: BoneLevel, whole: RigidTransform) -> PoseEstimate:
    """Return the pose with the covariance that halves of the bone, registered alone, show.

    Of two halves with independent errors, each differs from the whole by as much as the whole is off.
    """
    in_ct = whole.apply(points)
    middle = in_ct.mean(axis=0)
    squares = []
    for direction, side in product(PART_DIRECTIONS, (-1.0, 1.0)):
        part = np.flatnonzero(side * ((in_ct - middle) @ direction) > 0.0)
        part = part[:: max(1, len(part) // MOST_POINTS_OF_PART)]
        alone = refine_on_bone(points[part], values[part], target, whole, rescaled=True)
        off = alone * whole.inv()
        step = np.concatenate([off.rotation.as_rotvec(), off.apply(middle) - middle])
        squares.append(np.outer(step, step))
    common = np.diag([COMMON_RAD**2] * 3 + [COMMON_MM**2] * 3)
    return PoseEstimate(whole, middle, np.mean(squares, axis=0) + common)


def _require_one_skull(agreement: float, overlap: float) -> None:
    """Raise CBCT-004 unless both scans show the same bone."""
    if overlap < LEAST_OVERLAP or agreement < LEAST_AGREEMENT:
        raise OTHER_HEAD(
            "the bone of the scan does not match that of the planning CT",
            expected=f"agreement of at least {LEAST_AGREEMENT:g} over at least {LEAST_OVERLAP:.0%} of it",
            got=f"{agreement:.2f} over {overlap:.0%}",
        )
