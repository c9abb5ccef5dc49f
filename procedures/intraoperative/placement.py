"""Place of a scan in the planning CT by its spheres and its bone, in one adjustment.

A sphere that sits elsewhere than at the CT is found by the bone and the other spheres and takes no part; that
is what the scan is for. Spheres that agree among themselves and contradict the bone are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from procedures.intraoperative.bone_pose import PoseEstimate
from procedures.intraoperative.errors import BoneUncertain, SpheresContradict
from procedures.registration import register
from procedures.registration.error_theory import chi_square_limit, degrees_of_freedom
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array
from ronna_hw.text import format_against_limit

SAME_SPHERE_MM = 8.0  # less than two spheres can be apart; one that is farther off is on another screw
# Safety against spheres and bone that do not agree (U).
CONFIDENCE = 0.999  # one false alarm in a thousand scans
FEWEST_AGREEING = 2  # spheres that are where bone and CT have them: a mirrored scan has hardly any
POSE_FREEDOM = 6  # of a rotation and a shift
# Safety against the planning CT taken for a scan of the operation (U).
UNMOVED_SHARE = 1.0 / 3.0  # of the seating error per axis: refitted spheres are hardly ever all that near
# Safety against a scan whose place in the CT is uncertain (U).
LARGEST_ERROR_MM = 0.5  # expected, rms at a target: as for a fusion


@dataclass(frozen=True)
class SpherePair:
    """A sphere of the scan and that of the CT on the same screw, by index."""

    scan: int
    ct: int
    moved_mm: float  # since the CT
    agrees: bool  # it took part in the adjustment


@dataclass(frozen=True, eq=False)
class PlacedScan:
    """The adjusted pose, and what became of each sphere that both scans show.

    The error of `pose` is that of spheres that have not moved together, of `stated_pose` also of such as have
    and pass.
    """

    pose: PoseEstimate
    stated_pose: PoseEstimate
    pairs: tuple[SpherePair, ...]

    @property
    def agreeing(self) -> int:
        """Number of spheres that took part in the adjustment."""
        return sum(pair.agrees for pair in self.pairs)


@dataclass(frozen=True, eq=False)
class ScannedSpheres:
    """Centres (n, 3) mm and their covariances (n, 3, 3) mm2 in one scan."""

    centres_mm: Array
    covariances_mm2: Array


def place_scan(bone: PoseEstimate, scan: ScannedSpheres, ct: ScannedSpheres, seating_mm: float) -> PlacedScan:
    """Adjust the pose by bone to the spheres of both scans, refitted with an error per axis in between.

    Raises CBCT-006 where spheres and bone contradict each other.
    """
    places_mm = bone.ct_from_scan.apply(scan.centres_mm)
    pairs = _pair(places_mm, ct.centres_mm)
    rows, columns = (list(one) for one in zip(*pairs, strict=True)) if pairs else ([], [])
    rotation = bone.ct_from_scan.rotation.as_matrix()
    own_mm2 = (
        rotation @ scan.covariances_mm2[rows] @ rotation.T
        + ct.covariances_mm2[columns]
        + seating_mm**2 * np.eye(3)
    )
    measured = _Pairs(bone, places_mm[rows], ct.centres_mm[columns], own_mm2)
    kept = _select_agreeing(measured)
    _require_agreement(measured, kept, len(ct.centres_mm))
    step, covariance, chi_square = measured.adjust(kept)
    _require_fit(measured, kept, chi_square)
    pose = bone.moved(step, covariance)
    moved_mm = np.linalg.norm(
        pose.ct_from_scan.apply(scan.centres_mm)[rows] - ct.centres_mm[columns], axis=1
    ).tolist()
    return PlacedScan(
        pose,
        replace(pose, covariance=covariance + _unnoticed_covariance(bone.covariance, covariance)),
        tuple(
            SpherePair(row, column, off_mm, number in kept)
            for number, ((row, column), off_mm) in enumerate(zip(pairs, moved_mm, strict=True))
        ),
    )


def _unnoticed_covariance(of_bone: Array, of_both: Array) -> Array:
    """Return the covariance (6, 6) by which a common displacement of the spheres moves the pose unnoticed.

    Its chi square against the bone is as large as the limit, its direction unknown. The adjustment follows
    the spheres by I - N C, with the information C of the bone and the covariance N of both; the chi square of
    a displacement g is g C (I - N C) g. So all that the spheres add to the bone is at stake.
    """
    passing = chi_square_limit(POSE_FREEDOM, CONFIDENCE) / POSE_FREEDOM  # per direction
    return np.asarray(passing * (of_bone - of_both))


def require_certain(pose: PoseEstimate, points_mm: Array) -> None:
    """Raise CBCT-005 if the expected error at any of these points (n, 3) mm of the CT is too large."""
    worst_mm = float(np.sqrt(np.trace(pose.covariances_mm2(points_mm), axis1=1, axis2=2).max()))
    if worst_mm > LARGEST_ERROR_MM:
        raise BoneUncertain(
            "the place of the scan in the planning CT is too uncertain",
            limit=f"expected error of {LARGEST_ERROR_MM:g} mm rms at a target",
            got=f"{format_against_limit(worst_mm, LARGEST_ERROR_MM, 2)} mm",
        )


def are_unmoved(placed: PlacedScan, seating_mm: float) -> bool:
    """Return whether all spheres, three at least, are nearer to their places at the CT than refitted ones."""
    return len(placed.pairs) >= FEWEST_PAIRS and all(
        pair.moved_mm < UNMOVED_SHARE * seating_mm for pair in placed.pairs
    )


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of spheres as the bone has them: places, those of the CT (n, 3), covariances of a difference."""

    bone: PoseEstimate
    places_mm: Array
    ct_mm: Array
    own_mm2: Array

    def adjust(self, kept: Sequence[int]) -> tuple[Array, Array, float]:
        """Return step (6,), its covariance and chi square of the adjustment to bone and these pairs."""
        kept = list(kept)
        information = np.linalg.inv(self.bone.covariance)
        by_pose = pose_jacobian(self.places_mm, self.bone.middle_mm)[kept]
        weights = np.linalg.inv(self.own_mm2[kept])
        off_mm = (self.ct_mm - self.places_mm)[kept]
        normal = information + np.einsum("nij,nik,nkl->jl", by_pose, weights, by_pose)
        covariance = np.linalg.inv(normal)
        step = covariance @ np.einsum("nij,nik,nk->j", by_pose, weights, off_mm)
        left_mm = off_mm - by_pose @ step
        chi_square = float(step @ information @ step + np.einsum("ni,nij,nj->", left_mm, weights, left_mm))
        return step, covariance, chi_square

    def misfit(self, kept: Sequence[int]) -> float:
        """Return the chi square of a rigid fit of these pairs, at least three, without the bone."""
        rows = list(kept)
        fit = register(self.places_mm[rows], self.ct_mm[rows], covariance_mm2=self.own_mm2[rows])
        return fit.gate(confidence=CONFIDENCE).chi_square

    def distance(self, one: int, kept: Sequence[int]) -> float:
        """Return the chi square of one pair against the adjustment to the bone and the other `kept`."""
        step, covariance, _ = self.adjust([other for other in kept if other != one])
        by_pose = pose_jacobian(self.places_mm[one], self.bone.middle_mm)
        off_mm = self.ct_mm[one] - self.places_mm[one] - by_pose @ step
        return float(off_mm @ np.linalg.solve(self.own_mm2[one] + by_pose @ covariance @ by_pose.T, off_mm))


def _pair(places_mm: Array, ct_mm: Array) -> list[tuple[int, int]]:
    """Pair spheres with the nearest of the CT, if they can be on one screw."""
    apart_mm = np.linalg.norm(places_mm[:, None] - ct_mm[None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(apart_mm, SAME_SPHERE_MM))
    return [
        (int(row), int(column))
        for row, column in zip(rows, columns, strict=True)
        if apart_mm[row, column] < SAME_SPHERE_MM
    ]


def _select_agreeing(measured: _Pairs) -> list[int]:
    """Leave out the pair that contradicts bone and all others most, until none does."""
    kept = list(range(len(measured.ct_mm)))
    limit = chi_square_limit(3, CONFIDENCE)
    while kept:
        distances = {one: measured.distance(one, kept) for one in kept}
        worst = max(distances, key=lambda one: distances[one])
        if distances[worst] <= limit:
            break
        kept.remove(worst)
    return kept


def _require_agreement(measured: _Pairs, kept: Sequence[int], spheres: int) -> None:
    """Raise CBCT-006 if too few spheres are where the bone has them, or more are together elsewhere.

    A single sphere beside three or more that agree with the bone has moved, even if all fit each other.
    """
    together = _largest_rigid(measured)
    has_one_moved = len(kept) >= FEWEST_PAIRS and len(set(together) - set(kept)) <= 1
    if len(together) > len(kept) and not has_one_moved:
        raise SpheresContradict(
            f"{len(together)} spheres keep their distances and are not where the bone has them",
            expected=f"more than {len(together)} spheres that agree with the bone",
            got=str(len(kept)),
        )
    if len(kept) < min(FEWEST_AGREEING, spheres):
        raise SpheresContradict(
            "hardly any sphere of the scan is where the bone and the planning CT have it",
            expected=f"at least {min(FEWEST_AGREEING, spheres)}",
            got=str(len(kept)),
        )


def _require_fit(measured: _Pairs, kept: Sequence[int], chi_square: float) -> None:
    """Raise CBCT-006 if the bone and the spheres, which agree one by one, contradict each other as a whole.

    From three spheres on their own misfit is taken off: what remains is between the bone's pose and theirs.
    """
    freedom = 3 * len(kept)  # the pose is measured too, by the bone
    if len(kept) >= FEWEST_PAIRS:
        chi_square, freedom = chi_square - measured.misfit(kept), POSE_FREEDOM
    limit = chi_square_limit(freedom, CONFIDENCE)
    if chi_square > limit:
        raise SpheresContradict(
            f"{len(kept)} spheres agree with each other and are together beside where the bone has them",
            limit=f"chi square of {limit:.1f} between bone and spheres",
            got=format_against_limit(chi_square, limit, 1),
        )


def _largest_rigid(measured: _Pairs) -> tuple[int, ...]:
    """Return the largest group of at least three pairs that fit each other rigidly, or nothing."""
    count = len(measured.ct_mm)
    for size in range(count, FEWEST_PAIRS - 1, -1):
        for group in combinations(range(count), size):
            if measured.misfit(group) <= chi_square_limit(degrees_of_freedom(size), CONFIDENCE):
                return group
    return ()
