"""Judges a draft: mistakes, reach, clearance, and the expected error at each target.

Twice: immediately without clearance, and then like `ronna-plan check`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from console.planning.draft import Draft
from procedures.imaging.volume import Volume
from procedures.planning.errors import PlanMistakes
from procedures.planning.guide import held_trajectories
from procedures.planning.head_in_ct import skull_angle_rad
from procedures.planning.paths import check_paths
from procedures.planning.plan_check import PlanCheck, check_plan
from procedures.planning.plan_file import parse_plan
from procedures.planning.plan_model import MOST_INSTRUMENT_MM, Plan, PlannedTrajectory
from procedures.planning.structures import StructureDistance, structure_distances
from procedures.planning.target_error import predicted_by_markers, predicted_with_arm
from procedures.planning.theatre_arm import TheatreArm
from procedures.planning.visits import PathCheck
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.target_prediction import TargetPrediction
from ronna_hw.errors import RonnaError


@dataclass(frozen=True)
class Expected:
    """The expected error at one target; the squares of the shares add up to that of `rms_mm`."""

    rms_mm: float
    limit_mm: float  # contains it with 95 %
    shares_mm: tuple[tuple[str, float], ...]
    with_arm: bool  # otherwise from the markers alone


@dataclass(frozen=True)
class Judged:
    """For one draft. `thorough` means judged like `ronna-plan check`; before that clearance is unknown."""

    draft: Draft
    thorough: bool = False
    findings: tuple[RonnaError, ...] = ()
    warnings: tuple[str, ...] = ()
    expected: dict[str, Expected] = field(default_factory=dict)
    reached: tuple[str, ...] = ()  # in words, by the arm
    angles_deg: dict[str, float | None] = field(default_factory=dict)  # to the skull; 90 is perpendicular
    distances: tuple[StructureDistance, ...] = ()
    arm_known: bool = False
    complete: bool = False  # at least one trajectory has both ends, so there is something to judge


def judge(draft: Draft, volume: Volume, theatre: TheatreArm | None, *, thorough: bool) -> Judged:
    """Judge the trajectories whose ends are chosen. Never raises for problems of a draft."""
    judged = Judged(draft, thorough=thorough or theatre is None, arm_known=theatre is not None)
    if not any(one.ends for one in draft.ways):
        return judged
    judged = replace(judged, complete=True)
    missing: tuple[RonnaError, ...] = ()
    if draft.instrument_length_mm is None:  # everything else can be judged with any length
        missing = (
            PlanMistakes("the instrument length is missing", action="Enter it as printed on the packaging."),
        )
        draft = replace(draft, instrument_length_mm=MOST_INSTRUMENT_MM)
    try:
        plan = parse_plan(draft.content(volume.series_instance_uid))
    except RonnaError as mistake:
        return replace(judged, findings=(*missing, mistake))
    judged = replace(
        judged,
        angles_deg={one.id: _angle_deg(volume, one) for one in plan.trajectories},
        distances=structure_distances(plan),
    )
    markers_mm = np.array([one.centre_mm for one in draft.markers]).reshape(-1, 3)
    covariances_mm2 = np.array([one.covariance_mm2 for one in draft.markers]).reshape(-1, 3, 3)
    check, paths = _checked(plan, volume, markers_mm, theatre, thorough)
    unmet = () if thorough or paths is None else paths.unmet  # of a thorough check they are findings
    return replace(
        judged,
        findings=(*missing, *check.findings),
        warnings=(*(f"{one.pose}: {one.reason}" for one in unmet), *check.warnings),
        expected=_expected(plan, markers_mm, covariances_mm2, theatre, paths),
        reached=_in_words(check),
    )


def _angle_deg(volume: Volume, planned: PlannedTrajectory) -> float | None:
    angle_rad = skull_angle_rad(volume, planned.trajectory)
    return None if angle_rad is None else _degrees(angle_rad)


def _checked(
    plan: Plan,
    volume: Volume,
    markers_mm: NDArray[np.float64],
    theatre: TheatreArm | None,
    thorough: bool,
) -> tuple[PlanCheck, PathCheck | None]:
    enough = len(markers_mm) >= FEWEST_PAIRS
    if theatre is None:
        return check_plan(plan, volume, fiducials_mm=markers_mm), None
    if not thorough:
        check = check_plan(plan, volume, fiducials_mm=markers_mm, bore=theatre.bore)
        if check.findings or not enough:
            return check, None
        return check, check_paths(theatre.arm, held_trajectories(plan, theatre.bore), markers_mm)
    spheres = tuple((float(x), float(y), float(z)) for x, y, z in markers_mm)
    check = check_plan(
        plan,
        volume,
        fiducials_mm=markers_mm,
        to_fiducials=enough,
        arm=theatre.in_its_scene(volume, plan.fiducials, spheres),
        sight=theatre.sight,
        bore=theatre.bore,
    )
    return check, check.paths


def _expected(
    plan: Plan,
    markers_mm: NDArray[np.float64],
    covariances_mm2: NDArray[np.float64],
    theatre: TheatreArm | None,
    paths: PathCheck | None,
) -> dict[str, Expected]:
    if len(markers_mm) < FEWEST_PAIRS:
        return {}
    found = {}
    for one in plan.trajectories:
        try:
            if theatre is not None and paths is not None and paths.passed:
                predicted = predicted_with_arm(theatre, plan, covariances_mm2, paths, one.id)
                found[one.id] = _expected_of(predicted, with_arm=True)
            else:
                predicted = predicted_by_markers(markers_mm, covariances_mm2, one.target_mm)
                found[one.id] = _expected_of(predicted, with_arm=False)
        except (RonnaError, np.linalg.LinAlgError):  # collinear markers; the check reports it
            continue
    return found


def _expected_of(predicted: TargetPrediction, *, with_arm: bool) -> Expected:
    shares = sorted(predicted.budget_mm.items(), key=lambda one: -one[1])
    return Expected(predicted.rms_mm, predicted.limit_mm(), tuple(shares), with_arm)


def _in_words(check: PlanCheck) -> tuple[str, ...]:
    """What a check of the arm found, if it passed."""
    if check.paths is None:
        return ()
    lines = [f"all {len(check.paths.reached)} poses reached in one branch"]
    closest = [one.preview.closest for one in check.motions if one.preview.closest is not None]
    if closest:
        least = min(closest, key=lambda one: one.distance_mm)
        pair = f"{least.first}, {least.second}"
        lines.append(f"every motion is clear; smallest distance {least.distance_mm:.0f} mm ({pair})")
    lines += [
        f"{name} is rotated by {_degrees(turn):+.0f}° about its axis"
        for name, turn in check.turns_rad
        if turn
    ]
    return tuple(lines)


def _degrees(angle_rad: float) -> float:
    return float(np.degrees(angle_rad))
