"""Fusion of another series with a CT: the registration, and the evidence by which a wrong one is refused.

The evidence: starts apart from each other lead to one optimum, and six halves of the head, registered alone,
agree with the whole. A distortion, another head or too little contrast displace the halves differently.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial.transform import RigidTransform

from procedures.fusion.errors import (
    SAME_SERIES,
    LandmarksDisagree,
    NothingToFuse,
    PartsDisagree,
    StartsDisagree,
)
from procedures.fusion.mutual_information import (
    COARSE_MM,
    FINE_MM,
    MIDDLE_MM,
    Level,
    Optimum,
    build_level,
    flatten_shading,
    refine_pose,
    require_simple_itk,
    search_starts,
)
from procedures.fusion.record import FusedPose, Fusion, LandmarkCheck, expect_errors_mm
from procedures.imaging.pose_starts import measure_apart_mm
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array, Mask
from ronna_hw.text import format_against_limit

# Safety: a fusion with a larger expected error is refused. (U) As asked of a target chosen in an MR.
LARGEST_ERROR_MM = 0.5
LARGEST_LANDMARK_RMS_MM = 2.0  # a person places a landmark to about 1 mm in either series
FEWEST_LANDMARKS = 3
SAME_OPTIMUM_MM = 2.0  # rms in the head: starts that led closer together found the same optimum
FEWEST_AGREEING = 3  # of seven starts
RIVAL_SHARE = 0.95  # of the mutual information: another optimum nearly as good makes it ambiguous
LEAST_OVERLAP = 0.8  # of the head
INNER_MM = 25.0  # from the head's outer face: the region of targets
STAGES = 10  # levels, starts and halves, for the progress


def fuse_series(
    ct: Volume,
    other: Volume,
    modality: str,
    *,
    landmarks_mm: tuple[ArrayLike, ArrayLike] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Fusion:
    """Register another series to the CT. `landmarks_mm` are points (n, 3) of the CT, and of the other series.

    Raises FUS-001 without SimpleITK, FUS-002, FUS-004 to FUS-006 and FUS-008 where the result is not to be
    trusted.
    """
    require_simple_itk()
    if ct.series_instance_uid == other.series_instance_uid:
        raise SAME_SERIES("both series are the same")
    flat = flatten_shading(other)
    level = build_level(ct, flat, COARSE_MM)
    inner_mm = _inner_points(level)
    starts = search_starts(level)
    progress(2 / STAGES)
    agreeing = _require_one_optimum(starts, inner_mm)
    overlap = _measure_overlap(level, flat, starts[0].other_from_ct)
    level = build_level(ct, flat, MIDDLE_MM)
    middle = refine_pose(level, starts[0].other_from_ct, level.head)
    level = build_level(ct, flat, FINE_MM)
    fine = refine_pose(level, middle.other_from_ct, level.head)
    parts = []
    for number, half in enumerate(_halves(level)):
        part = refine_pose(level, fine.other_from_ct, half)
        parts.append(FusedPose.of(part.other_from_ct.inv()))
        progress((4 + number) / STAGES)
    whole, others = FusedPose.of(fine.other_from_ct.inv()), tuple(parts)
    expected_mm = float(np.sqrt(np.mean(expect_errors_mm(whole, others, inner_mm) ** 2)))
    fusion = Fusion(
        schema=1,
        ct_series_uid=ct.series_instance_uid,
        other_series_uid=other.series_instance_uid,
        other_frame_uid=other.frame_of_reference_uid,
        modality=modality,
        ct_from_other=whole,
        parts=others,
        expected_mm=expected_mm,
        starts=len(starts),
        agreeing_starts=agreeing,
        information=fine.information,
        overlap=overlap,
        landmarks=None if landmarks_mm is None else check_landmarks(whole, *landmarks_mm),
    )
    if expected_mm > LARGEST_ERROR_MM:
        raise PartsDisagree(
            "halves of the head, registered alone, contradict the whole",
            limit=f"expected error of {LARGEST_ERROR_MM:g} mm rms in the head",
            got=f"{format_against_limit(expected_mm, LARGEST_ERROR_MM, 2)} mm",
        )
    return fusion


def check_landmarks(whole: FusedPose, ct_mm: ArrayLike, other_mm: ArrayLike) -> LandmarkCheck:
    """Check a registration by landmarks (n, 3) mm in the CT and, in the same order, the other series.

    Raises FUS-006.
    """
    there, here = np.asarray(other_mm, dtype=float), np.asarray(ct_mm, dtype=float)
    if there.shape != here.shape or len(here) < FEWEST_LANDMARKS:
        raise LandmarksDisagree(
            "the landmarks of the two series are not pairs",
            expected=f"at least {FEWEST_LANDMARKS} in each, in one order",
            got=f"{len(here)} and {len(there)}",
        )
    off_mm = np.linalg.norm(whole.rigid.apply(there) - here, axis=1)
    check = LandmarkCheck(
        count=len(here), rms_mm=float(np.sqrt(np.mean(off_mm**2))), largest_mm=float(off_mm.max())
    )
    if check.rms_mm > LARGEST_LANDMARK_RMS_MM:
        raise LandmarksDisagree(
            f"{len(here)} landmarks do not meet; the worst is number {int(off_mm.argmax()) + 1}, "
            f"{off_mm.max():.1f} mm off",
            limit=f"{LARGEST_LANDMARK_RMS_MM:g} mm rms",
            got=f"{format_against_limit(check.rms_mm, LARGEST_LANDMARK_RMS_MM, 2)} mm",
        )
    return check


def _require_one_optimum(starts: Sequence[Optimum], inner_mm: Array) -> int:
    """Return how many starts led to the best optimum. Raises FUS-004."""
    best = starts[0]
    apart_mm = [measure_apart_mm(best.other_from_ct, one.other_from_ct, inner_mm) for one in starts]
    agreeing = sum(apart <= SAME_OPTIMUM_MM for apart in apart_mm)
    rivals = [
        apart
        for one, apart in zip(starts, apart_mm, strict=True)
        if apart > SAME_OPTIMUM_MM and one.information > RIVAL_SHARE * best.information
    ]
    if rivals:
        raise StartsDisagree(
            f"two results {rivals[0]:.1f} mm apart are equally likely",
            expected=f"one, with all others below {RIVAL_SHARE:.0%} of its mutual information",
        )
    if agreeing < FEWEST_AGREEING:
        raise StartsDisagree(
            "too few starts led to the best result",
            expected=f"at least {FEWEST_AGREEING} of {len(starts)}",
            got=str(agreeing),
        )
    return agreeing


def _inner_points(level: Level) -> Array:
    """Return points (n, 3) mm of the CT well inside the head. Raises FUS-002."""
    rounds = max(1, round(INNER_MM / float(level.geometry.spacing_mm.mean())))
    inner = ndimage.binary_erosion(level.head, iterations=rounds)
    if not inner.any():
        raise NothingToFuse("the CT shows too little of the head")
    return level.geometry.to_patient_mm(np.argwhere(inner))


def _measure_overlap(level: Level, other: Volume, pose: RigidTransform) -> float:
    """Return the share of the head that the other series shows. Raises FUS-002."""
    head_mm = level.geometry.to_patient_mm(np.argwhere(level.head))
    share = float(other.geometry.contains(pose.apply(head_mm)).mean())
    if share < LEAST_OVERLAP:
        raise NothingToFuse(
            "the other series shows only part of the head",
            expected=f"at least {LEAST_OVERLAP:.0%}",
            got=f"{share:.0%}",
        )
    return share


def _halves(level: Level) -> list[Mask]:
    """Return the halves of the head, left and right, front and back, below and above its middle."""
    index = np.argwhere(level.head)
    places = level.geometry.to_patient_mm(index)
    found = []
    for axis, side in product(range(3), (-1.0, 1.0)):
        half = np.zeros_like(level.head)
        chosen = index[side * (places[:, axis] - places[:, axis].mean()) > 0.0]
        half[tuple(chosen.T)] = True
        found.append(half)
    return found
