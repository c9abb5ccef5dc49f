"""Refusals of a surface registration, and the limits behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from procedures.registration.surface.changed_skin import ChangedSkin
from procedures.registration.surface.errors import (
    FAR_FROM_START,
    HEAD_MOVED,
    LITTLE_COVERAGE,
    MIRRORED_HEAD,
    MUCH_EXCLUDED,
    OTHER_HEAD,
    POORLY_DETERMINED,
    SKIN_CHANGED,
)
from procedures.registration.surface.evidence import weigh_displacements
from procedures.registration.surface.misfit import MisfitModel
from procedures.registration.surface.regions import HEAD_MM, HeadAxes
from procedures.registration.surface.settling import Pose, Settled, settle
from procedures.registration.surface.starts import Start, pose_of
from procedures.registration.surface.surface import Surface
from ronna_hw.arrays import Array, Mask

COVERED_MM = 10.0  # a sample this near to a scanned point is covered
CLEARLY_MIRRORED_MM2 = 0.1  # between the mean squares of the two sides: a third of a millimetre
START_SIGMAS = 4.0
MOVED_TURN_RAD, MOVED_MM = np.radians(1.0), 2.0  # of a head or cart that moved between looks (U)
MOST_SPLITS = 12  # moments of a movement that are tried: the next one is near enough
MOVED_EVIDENCE = 8.0  # log Bayes factor: one in three thousand, several movements tried
FEWEST_IN_GROUP = 12  # points on either side of a movement: two for each of its unknowns
DIRECTIONS = ("left to right", "front to back", "head to feet")  # the axes of the CT
# Square of the distance of a pose from its landmarks, in their standard deviations: 1 in 100 of six unknowns.
# Safety against another head, or an arm that errs, which a pose far off fits best. Source: chi-squared.
LARGEST_LANDMARK_SQUARE = 16.8


@dataclass(frozen=True)
class SurfaceLimits:
    """Limits beyond which a surface registration is refused."""

    # Share of the head's surface above the jaw. Half of a face has about this much.
    # Safety against a pose from a patch without features. Source: parametric heads.
    least_coverage: float = 0.07
    # Predicted error that contains 95 % of targets.
    # Safety against a scan that does not determine the target. Source: usual margin of a plan (U).
    largest_error_mm: float = 2.0
    # Robust standard deviation of the distances: skin of the same head stays well below, another head above.
    # Safety against the CT of another patient. Source: parametric heads.
    largest_residual_mm: float = 0.9
    # Shares of the scan that are another body, that are another body or hair, and that are skin that changed.
    # Safety against hands, drapes and hair taken for the head, and skin that moved. Source: parametric heads.
    most_excluded: float = 0.25
    most_hidden: float = 0.33
    most_changed: float = 0.2


def require_same_head(found: Settled, limits: SurfaceLimits) -> None:
    """Raise SRF-005 if the scan does not lie on the surface."""
    if found.sigma_mm > limits.largest_residual_mm:
        raise OTHER_HEAD(
            "the scan does not lie on the surface of the CT",
            limit=f"{limits.largest_residual_mm:g} mm",
            got=f"{found.sigma_mm:.2f} mm",
        )


def require_skin(is_other: Mask, limits: SurfaceLimits) -> None:
    """Raise SRF-010 if other bodies make up too much of the scan."""
    if is_other.mean() > limits.most_excluded:
        raise MUCH_EXCLUDED(
            "much of the scan is off the surface of the CT",
            limit=f"{limits.most_excluded:.0%}",
            got=f"{is_other.mean():.0%}",
        )


def require_bare_skin(excluded: Mask, limits: SurfaceLimits) -> None:
    """Raise SRF-010 if other bodies and hair make up too much of the scanned area."""
    if excluded.mean() > limits.most_hidden:
        raise MUCH_EXCLUDED(
            "much of the scan is hair, or off the surface of the CT",
            limit=f"{limits.most_hidden:.0%}",
            got=f"{excluded.mean():.0%}",
        )


def require_coverage(share: float, points: int, limits: SurfaceLimits) -> float:
    """Return the share of the head that was scanned. Raises SRF-002 if it is too small."""
    if share < limits.least_coverage:
        raise LITTLE_COVERAGE(
            "the scan covers too little of the head",
            limit=f"{limits.least_coverage:.0%}",
            got=f"{share:.1%}, {points} points",
        )
    return share


def share_covered(places_mm: Array, surface: Surface, axes: HeadAxes) -> float:
    """Return the share of the head above the jaw's angle that lies near scanned places."""
    samples = surface.points_mm[axes.depth_mm(surface.points_mm) < HEAD_MM]
    distances, _ = cKDTree(places_mm).query(samples, distance_upper_bound=COVERED_MM)
    return float(np.isfinite(distances).mean())


def is_side_proven(
    found: Settled, used: Mask, points_mm: Array, view_mm: Array, surface: Surface, axes: HeadAxes
) -> bool:
    """Return whether the mirror image of the scan fits clearly worse. Raises SRF-006 if it fits better."""
    flip = np.diag([-1.0, 1.0, 1.0])
    across = np.array([2.0 * axes.middle_mm[0], 0.0, 0.0])
    mirrored = Pose(flip @ found.pose.rotation @ flip, flip @ found.pose.translation_mm + across)
    other = settle(mirrored, points_mm @ flip, view_mm @ flip, surface, used)
    # A place that is no surface in one of both, such as a thin ear, says nothing; few points must not decide.
    both = found.valid & other.valid
    here, there = found.capped_mean_mm2(both), other.capped_mean_mm2(both)
    if here > there + CLEARLY_MIRRORED_MM2:
        got = f"{there**0.5:.2f} mm rms, else {here**0.5:.2f} mm"
        raise MIRRORED_HEAD("left and right of the CT are exchanged", got=got)
    return there > here + CLEARLY_MIRRORED_MM2


def require_still(model: MisfitModel, jacobian: Array, distances_mm: Array, look: NDArray[np.int64]) -> None:
    """Raise SRF-007 if some looks were taken of a head elsewhere: one of them, or all from one on."""
    numbers = np.unique(look)
    groups = {f"from look {one} on": look >= one for one in numbers[1 :: 1 + len(numbers) // MOST_SPLITS]}
    if len(numbers) <= MOST_SPLITS:
        groups |= {f"at look {one}": look == one for one in numbers[1:-1]}
    fewest, most = FEWEST_IN_GROUP, len(look) - FEWEST_IN_GROUP
    groups = {name: rows for name, rows in groups.items() if fewest <= rows.sum() <= most}
    size = np.repeat([MOVED_TURN_RAD, MOVED_MM], 3)
    columns = [jacobian * size * rows[:, None] for rows in groups.values()]
    weighed = weigh_displacements(model, jacobian, distances_mm, columns)
    if not weighed:
        return
    name, worst = max(zip(groups, weighed, strict=True), key=lambda item: item[1].log_evidence)
    if worst.log_evidence > MOVED_EVIDENCE:
        moved = worst.size * size
        raise HEAD_MOVED(
            f"the head is elsewhere {name}",
            got=f"{np.linalg.norm(moved[3:]):.1f} mm and {np.degrees(np.linalg.norm(moved[:3])):.1f} deg",
        )


def require_agreement(changed: ChangedSkin | None, limits: SurfaceLimits) -> None:
    """Raise SRF-008 if the skin changed over too much of the scan."""
    if changed is not None and changed.points.mean() > limits.most_changed:
        raise SKIN_CHANGED(
            f"the skin is elsewhere at {', '.join(changed.parts)}",
            limit=f"{limits.most_changed:.1%} of the scan",
            got=f"{changed.points.mean():.1%}, by {changed.shift_mm:.1f} mm",
        )


def require_start(pose: Pose, start: Start | None, axes: HeadAxes) -> None:
    """Raise SRF-009 if the pose is further from its start than that explains."""
    if start is None:
        return
    at_mm = axes.centre_mm
    before = pose_of(start.robot_from_ct)
    turn = float(Rotation.from_matrix(pose.rotation @ before.rotation.T).magnitude())
    robot = (at_mm - pose.translation_mm) @ pose.rotation
    place = float(np.linalg.norm(before.apply(robot[None])[0] - at_mm))
    if start.landmarks_ct_mm is not None:
        _require_landmarks(pose, before, start.landmarks_ct_mm, start.place_mm)
    turn_limit, place_limit_mm = START_SIGMAS * start.turn_rad, START_SIGMAS * start.place_mm
    if turn > turn_limit or place > place_limit_mm:
        raise FAR_FROM_START(
            "the registration ended far from its start",
            limit=f"{np.degrees(turn_limit):.1f} deg and {place_limit_mm:.1f} mm",
            got=f"{np.degrees(turn):.1f} deg and {place:.1f} mm",
        )


def _require_landmarks(pose: Pose, before: Pose, landmarks_ct_mm: Array, deviation_mm: float) -> None:
    """Raise SRF-009 if the pose puts landmarks further from where they were touched than they err."""
    touched = (landmarks_ct_mm - before.translation_mm) @ before.rotation
    away_mm = np.linalg.norm(pose.apply(touched) - landmarks_ct_mm, axis=1)
    limit_mm = deviation_mm * float(np.sqrt(LARGEST_LANDMARK_SQUARE / len(away_mm)))
    rms_mm = float(np.sqrt(np.mean(away_mm**2)))
    if rms_mm > limit_mm:
        raise FAR_FROM_START(
            "the registration puts the landmarks elsewhere than they were touched",
            limit=f"{limit_mm:.1f} mm rms",
            got=f"{rms_mm:.1f} mm",
        )


def require_determined(
    limit_mm: float, covariance_ct_mm2: Array, target_ct_mm: Array, limits: SurfaceLimits
) -> None:
    """Raise SRF-003 if the predicted error of a target is too large, with its worst direction."""
    if limit_mm <= limits.largest_error_mm:
        return
    worst = np.linalg.eigh(covariance_ct_mm2)[1][:, -1]
    place = ", ".join(f"{value:.0f}" for value in target_ct_mm)
    raise POORLY_DETERMINED(
        f"the target at {place} mm is not determined, worst {DIRECTIONS[int(np.abs(worst).argmax())]}",
        limit=f"{limits.largest_error_mm:g} mm with 95 %",
        got=f"{limit_mm:.2f} mm",
    )
