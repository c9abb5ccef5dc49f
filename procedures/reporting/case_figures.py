"""Measurements of a run so far, in the robot frame, for drawing.

Read from the folder of a run, running or finished; what does not exist yet, or cannot be read, is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from procedures.engine.case import Stored, stand_ins, without_ancestors
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.journal.results import StepResult
from procedures.operator.question import Evidence, PredictedError
from procedures.reporting.pictures import timeline_figure
from procedures.reporting.run_reading import RunReading, read_for_report
from procedures.reporting.run_statistics import timeline
from procedures.reporting.sections.surface import SURFACE_PICTURES, SurfaceSection, read_surface
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.error_budget import budget_table, two_way_table
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import RegisteredRobot, Relocalization
from ronna_hw.evidence.manifest import PICTURES_FOLDER
from ronna_hw.frames import Transform

# Steps, by name, of a case with spheres or on the skin.
MATCHED, LOCALIZED, REGISTERED = (
    frozenset(stand_ins(model)) for model in (Correspondence, Relocalization, RegisteredRobot)
)
Point = tuple[float, float, float]
R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class SphereFigure:
    """Sphere from the CT, with its position by each instrument in mm, None where unknown."""

    number: int  # counts from 1
    ct_mm: Point | None  # by the registration
    tracker_mm: Point | None
    stereo_mm: Point | None


@dataclass(frozen=True)
class TrajectoryFigure:
    """Planned trajectory in the robot frame, mapped by its registration, mm."""

    name: str
    entry_mm: Point
    target_mm: Point


@dataclass(frozen=True)
class CaseFigures:
    """All figures of a case known so far."""

    robot_from_ct: Transform | None = None  # corrected for the target where the guide came last
    robot_from_tracker: Transform | None = None
    spheres: tuple[SphereFigure, ...] = ()
    trajectories: tuple[TrajectoryFigure, ...] = ()
    predictions: tuple[PredictedError, ...] = ()
    margins_mm: Mapping[str, float] = field(default_factory=dict)  # of the plan, by target
    tables: tuple[Evidence, ...] = ()
    pictures: tuple[str, ...] = ()  # names in the folder `pictures`, from the stereo head
    cuts: tuple[str, ...] = ()  # and those of the planned trajectories in the CT
    problems: tuple[str, ...] = ()  # what cannot be read, or has changed since the run
    surface: SurfaceSection | None = None  # registration on the skin
    course: str = ""  # SVG of the run's theatre time


def read_case_figures(folder: Path, *, every_file: bool = False) -> CaseFigures:
    """Read the figures of a run. Damaged files never raise errors.

    Without `every_file` only journal and records are compared: the others change while it runs.
    """
    reading = read_for_report(folder, every_file=every_file)
    coarse, tracked = reading.find(Correspondence), reading.find(GlobalLocalization)
    stored = _currently_valid(reading, RegisteredRobot)
    registered, target = [one.result for one in stored], _find_target(reading)
    poses = {name: one.robot_from_ct_at(target) for one in registered for name in one.trajectories}
    latest = registered[-1].robot_from_ct_at(target) if registered else None
    pose = latest or (coarse.robot_from_ct.transform if coarse else None)
    plan = reading.find(CheckedPlan)
    margins_mm = {one.id: one.margin_mm for one in plan.plan.trajectories} if plan else {}
    spans = timeline(reading.run.journal)
    predictions = [one for used in reading.registrations for one in used.predictions]
    return CaseFigures(
        robot_from_ct=pose,
        robot_from_tracker=tracked.robot_from_tracker.transform if tracked else None,
        spheres=_spheres(reading, pose, _stereo_points(reading, stored, target)),
        trajectories=_trajectories(plan, poses, pose),
        predictions=tuple(
            one.against(margins_mm[one.target]) for one in predictions if one.target in margins_mm
        ),
        margins_mm=margins_mm,
        tables=(
            *(budget_table(one) for one in predictions),
            *([two_way_table(registered[-1].two_way)] if registered and registered[-1].pairs else ()),
        ),
        problems=(*reading.changes, *reading.problems),
        pictures=(*_pictures(folder, "stereo-"), *_pictures(folder, SURFACE_PICTURES)),
        surface=read_surface(reading),
        cuts=_pictures(folder, PLAN_PICTURE),
        course=timeline_figure(spans) if spans else "",
    )


def _currently_valid(reading: RunReading, model: type[R]) -> list[Stored[R]]:
    """Return the valid results, without those of targets finished before something moved."""
    past = without_ancestors(reading.run.valid_records)
    return [one for one in reading.valid_results(model) if one.record.identifier not in past]


def _find_target(reading: RunReading) -> str | None:
    """Return the target where the guide came last, None before: by its correction all is drawn as the arm is.

    A learned arm errs by millimetres, by nearly as much at spheres and targets: only by a pose that is
    corrected for that does the drawn guide end on the drawn target.
    """
    reached = reading.valid_results(PositionedGuide)
    return reached[-1].record.trajectory if reached else None


def _stereo_points(
    reading: RunReading, registered: Sequence[Stored[RegisteredRobot]], target: str | None
) -> dict[int, Point]:
    """Return each sphere as the stereo head found it: through its registration, and raw before that."""
    points: dict[int, Point] = {}
    for fine in _currently_valid(reading, Relocalization):
        found = dict(zip(fine.result.fiducials, fine.result.points_mm, strict=True))
        for fit in registered:
            if fine.record.identifier in fit.record.parents:
                pose, in_ct = fit.result.robot_from_ct_at(target), fit.result.found_in_ct_mm(fine.result)
                found = {fiducial: pose.apply(place_mm) for fiducial, place_mm in in_ct.items()}
        points |= {fiducial: _point(place_mm) for fiducial, place_mm in found.items()}
    return points


def _pictures(folder: Path, prefix: str) -> tuple[str, ...]:
    return tuple(sorted(path.name for path in (folder / PICTURES_FOLDER).glob(f"{prefix}*.png")))


def _spheres(
    reading: RunReading, pose: Transform | None, stereo: dict[int, Point]
) -> tuple[SphereFigure, ...]:
    localized = reading.find(LocalizedFiducials)
    if localized is None:
        return ()
    coarse, tracked = reading.find(Correspondence), reading.find(GlobalLocalization)
    partner = {pair[0]: pair[1] for pair in coarse.pairs} if coarse else {}
    return tuple(
        SphereFigure(
            number=number,
            ct_mm=None if pose is None else _point(pose.apply(marker.centre_mm)),
            tracker_mm=_point(tracked.points_mm[partner[number - 1]])
            if tracked and number - 1 in partner
            else None,
            stereo_mm=stereo.get(number - 1),
        )
        for number, marker in localized.numbered.items()
    )


def _trajectories(
    plan: CheckedPlan | None, poses: dict[str, Transform], pose: Transform | None
) -> tuple[TrajectoryFigure, ...]:
    if plan is None:
        return ()
    found = []
    for one in plan.plan.trajectories:
        best = poses.get(one.id, pose)
        if best is not None:
            entry_mm, target_mm = _point(best.apply(one.entry_mm)), _point(best.apply(one.target_mm))
            found.append(TrajectoryFigure(one.id, entry_mm, target_mm))
    return tuple(found)


def _point(values: object) -> Point:
    x, y, z = np.asarray(values, dtype=float).tolist()
    return (x, y, z)
