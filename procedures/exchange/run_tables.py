"""Results of a run as tables: targets, spheres, registrations, motions and events.

Each table is declared by its columns and filled from the run's own models. Only records are read; what the
devices answered is in `recorded_tables`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from procedures.engine.case import results_of
from procedures.engine.events.event_file import FollowedRun
from procedures.exchange.case_results import reached_lines
from procedures.exchange.case_spheres import CaseSpheres
from procedures.journal.journal import Entry, Line, theatre_time_s
from procedures.reporting.outcome import Truth
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.reporting.tables import target_rows
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot, Relocalization
from procedures.steps.clinical.target_measurement import MeasuredTarget
from ronna_hw.evidence.inspection import Inspection
from ronna_hw.loaded_run import RunColumn, RunTable

NOWHERE = (math.nan,) * 3
AXES = 6  # of an arm of which no joints are known
UNKNOWN_COVARIANCE = (NOWHERE,) * 3

TARGETS = (
    RunColumn("name", str, "of the trajectory in the plan"),
    RunColumn("depth_mm", float, "from entry to target"),
    RunColumn("margin_mm", float, "largest error that the plan accepts"),
    RunColumn("strategy", str, "used; another than the run's if the operator agreed to it, and with `best`"),
    RunColumn(
        "predicted_mm", float, "predicted error at the target, root mean square; NaN without a registration"
    ),
    RunColumn("limit_mm", float, "radius that holds the error with the confidence"),
    RunColumn("confidence", float, "of that radius, 0 to 1"),
    RunColumn(
        "error_mm", float, "of the instrument's tip against the truth of the simulated theatre; else NaN"
    ),
    RunColumn("lateral_mm", float, "its component across the planned axis"),
    RunColumn("axial_mm", float, "its component along it, positive if too deep"),
    RunColumn(
        "measured_mm", float, "measured by the stereo head in place of the guide, on a phantom; else NaN"
    ),
    RunColumn("entry_ct_mm", float, "planned entry", (3,)),
    RunColumn("target_ct_mm", float, "planned target", (3,)),
    RunColumn(
        "target_robot_mm",
        float,
        "place to which the arm is sent for it: by its registration, with the learned correction",
        (3,),
    ),
    RunColumn(
        "correction_robot_mm",
        float,
        "that correction, for errors learned of the arm; zero by any strategy but `learning`",
        (3,),
    ),
    RunColumn("reached_robot_mm", float, "instrument's tip by joints and depth stop; not the truth", (3,)),
    RunColumn("reached_ct_mm", float, "the same, back through registration and correction", (3,)),
)
SPHERES = (
    RunColumn("name", str, "M1, M2, ... from superior to inferior"),
    RunColumn(
        "centre_ct_mm",
        float,
        "its centre as it counts: by the CT or, after a scan of the clamped head, by that scan",
        (3,),
    ),
    RunColumn("planning_ct_mm", float, "its centre in the planning CT; NaN if it is new since", (3,)),
    RunColumn("covariance_ct_mm2", float, "of the centre", (3, 3)),
    RunColumn("radius_mm", float, "fitted radius"),
    RunColumn(
        "quality", float, "share of the surface used, 0 to 1, reduced by disagreement of the estimates"
    ),
    RunColumn("agreement_mm", float, "between the two estimates of the centre"),
    RunColumn("odds", float, "that it is a marker, 0 to 1"),
)
LOCALIZED = (
    RunColumn("step", str, "step that localized it, such as `relocalization:T1`"),
    RunColumn("standing", bool, "whether the result still holds; False once another took its place"),
    RunColumn("sphere", str, "its name in `spheres`"),
    RunColumn(
        "axis", str, "of the look, as the path check names it, such as `T1` or `T1 jdms`; empty without one"
    ),
    RunColumn(
        "robot_from_tool_wxyz",
        float,
        "planned rotation robot <- tool, scalar first; NaN without a path check",
        (4,),
    ),
    RunColumn("centre_robot_mm", float, "its centre by the stereo head", (3,)),
    RunColumn("stereo_covariance_robot_mm2", float, "of the stereo measurement alone: no arm, no CT", (3, 3)),
    RunColumn(
        "total_covariance_robot_mm2",
        float,
        "of CT, seating of the sphere, stereo measurement and arm together, which weighted the registration: "
        "what `register` asks for; NaN without one",
        (3, 3),
    ),
    RunColumn("residual_mm", float, "last residual of the servo"),
    RunColumn("ray_gap_mm", float, "between the two lines of sight"),
    RunColumn("looks", int, "image pairs taken"),
    RunColumn("joints_rad", float, "measured at the last image pair", (AXES,)),
)
REGISTRATIONS = (
    RunColumn("record", str, "its record in the run folder"),
    RunColumn("targets", str, "targets it serves, separated by blanks"),
    RunColumn("standing", bool, "whether the result still holds; False once another took its place"),
    RunColumn("pairs", int, "spheres it was fitted to"),
    RunColumn("fre_mm", float, "fiducial registration error; not a measure of accuracy"),
    RunColumn(
        "robot_from_ct_mm", float, "origin of the CT in the robot frame, by the head as registered", (3,)
    ),
    RunColumn("robot_from_ct_wxyz", float, "rotation robot <- ct, scalar first", (4,)),
)
BUDGET = (
    RunColumn("target", str, "name of the trajectory"),
    RunColumn("record", str, "registration that the prediction belongs to"),
    RunColumn("standing", bool, "whether the result still holds; False once another took its place"),
    RunColumn("source", str, "source of error, such as `CT` or `links and joint offsets`"),
    RunColumn("rms_mm", float, "its rms at the target; the squares add up to that of `predicted_mm`"),
)
MOTIONS = (
    RunColumn("motion", int, "its number in the run, from 1"),
    RunColumn("arm", str, "such as `master`"),
    RunColumn("step", str, "step that moved the arm; empty for the way home outside the steps"),
    RunColumn("kind", str, "such as `go`, `line`, `insert`, `home`"),
    RunColumn("begin_s", float, "theatre time of its journal line"),
    RunColumn("end_s", float, "theatre time at rest; NaN if the journal ends before"),
    RunColumn("goal_rad", float, "commanded joints; NaN for a straight line", (AXES,)),
    RunColumn("goal_robot_mm", float, "end of a straight line, origin of the tool frame; else NaN", (3,)),
    RunColumn("joints_rad", float, "measured at rest; NaN if the motion failed", (AXES,)),
    RunColumn("error", str, "code of the error that ended it"),
)
EVENTS = (
    RunColumn("number", int, "of the event in the run; starts again when the run is resumed"),
    RunColumn("theatre_time_s", float, "theatre time"),
    RunColumn("host_time", "datetime64[ms]", "the computer's time, UTC"),
    RunColumn("kind", str, "such as `step`, `question`, `answer`, `pose`, `fault`"),
    RunColumn("step", str, "step it belongs to, if it names one"),
    RunColumn("content", object, "all of it, as JSON"),
)


def targets_table(reading: RunReading, truth: Truth) -> RunTable:
    """Return one row per planned trajectory. Raises REC-001, REC-003."""
    run = reading.run
    for model in (CheckedPaths, MeasuredTarget, RegisteredRobot):
        results_of(model, run.records)  # raises for an unreadable record, which a report leaves out
    plans, registrations = results_of(CheckedPlan, run.valid_records), reading.registrations
    plan = plans[-1].result if plans else None
    trajectories = () if plan is None else plan.plan.trajectories
    known = {row.target: row for row in target_rows(reading, truth)}
    used, strategies = {name: one for one in registrations for name in one.targets}, reading.strategies
    lines = reached_lines(run, plan, registrations, {one.id: one.id for one in trajectories})
    rows = []
    for planned in trajectories:
        row, registration, line = known.get(planned.id), used.get(planned.id), lines.get(planned.id)
        target_mm = tip_mm = correction_mm = np.array(NOWHERE)
        tip_ct_mm = NOWHERE if line is None else line.end_mm
        if registration is not None:
            robot_from_ct = registration.result.robot_from_ct_at(planned.id)
            target_mm, tip_mm = robot_from_ct.apply(planned.target_mm), robot_from_ct.apply(tip_ct_mm)
            correction_mm = np.array(registration.result.correction_mm(planned.id))
        plain = (planned.id, planned.depth_mm, planned.margin_mm, strategies.get(planned.id, ""))
        prediction = _numbers(None if row is None else row.predicted, "rms_mm", "limit_mm", "confidence")
        errors = _numbers(row, "error_mm", "lateral_mm", "axial_mm", "measured_mm")
        points = (planned.entry_mm, planned.target_mm, target_mm, correction_mm, tip_mm, tip_ct_mm)
        rows.append((*plain, *prediction, *errors, *points))
    return RunTable.of(TARGETS, rows)


def _numbers(source: object, *names: str) -> tuple[float, ...]:
    """Return numbers of a source; NaN for what it does not know, or without a source."""
    found = (getattr(source, name, None) for name in names)
    return tuple(math.nan if value is None else value for value in found)


def spheres_table(run: Inspection) -> RunTable:
    """Return one row per sphere found in the CT. Raises REC-001, REC-003."""
    found = CaseSpheres.of(run.valid_records)
    if found is None:
        return RunTable.of(SPHERES, ())
    rows = []
    for number, one in found.used.result.numbered.items():
        fit = (one.radius_mm, one.quality, one.agreement_mm, one.odds)
        places = (one.centre_mm, found.planning_ct_mm.get(number, NOWHERE))
        rows.append((sphere_name(number - 1), *places, one.covariance_mm2, *fit))
    return RunTable.of(SPHERES, rows)


def sphere_name(index: int) -> str:
    """Return the name of a sphere by its index in the CT, as exported: M1, M2, ..."""
    return f"M{index + 1}"


def localized_table(run: Inspection) -> RunTable:
    """Return one row per sphere and fine localization. Raises REC-001, REC-003."""
    rows = []
    totals_mm2 = _find_total_covariances_mm2(run)
    checks = {stored.record.identifier: stored.result for stored in results_of(CheckedPaths, run.records)}
    for stored in results_of(Relocalization, run.records):
        one, record = stored.result, stored.record
        step = ":".join(filter(None, (record.kind, record.trajectory)))
        standing = record.identifier not in run.superseded
        paths = next((checks[parent] for parent in record.parents if parent in checks), None)
        planned = [] if paths is None else paths.looks_for(record.trajectory)
        rotations = {(axis, look.fiducial): (axis, look.tool_pose.quaternion_wxyz) for axis, look in planned}
        only_axis = planned[0][0] if planned else ""
        axes = one.axes or (only_axis,) * len(one.fiducials)
        for index, (fiducial, axis) in enumerate(zip(one.fiducials, axes, strict=True)):
            turned = rotations.get((axis, fiducial), ("", (math.nan,) * 4))
            total_mm2 = totals_mm2.get((record.identifier, fiducial), UNKNOWN_COVARIANCE)
            place = (one.points_robot_mm[index], one.covariances_mm2[index], total_mm2)
            servo = (one.residuals_mm[index][-1], one.ray_gaps_mm[index], one.looks[index])
            rows.append(
                (step, standing, sphere_name(fiducial), *turned, *place, *servo, one.joints_rad[index])
            )
    return RunTable.of(_with_axes(LOCALIZED, len(rows[0][-1]) if rows else AXES), rows)


def _find_total_covariances_mm2(run: Inspection) -> dict[tuple[str, int], Any]:
    """Map relocalization record and sphere to the covariance that its last registration was weighted with."""
    found: dict[tuple[str, int], Any] = {}
    localizations = {
        stored.record.identifier: stored.result for stored in results_of(Relocalization, run.records)
    }
    for stored in results_of(RegisteredRobot, run.records):
        left_out = {one.fiducial for one in stored.result.left_out_spheres}
        for identifier in localizations.keys() & stored.record.parents.keys():
            learned = stored.result.learned
            looked = localizations[identifier].fiducials if learned is None else learned.fiducials
            used = [one for one in looked if one not in left_out]
            covariances = stored.result.covariances_mm2 or [UNKNOWN_COVARIANCE] * len(used)
            pairs = zip(used, covariances, strict=True)
            found |= {(identifier, fiducial): covariance for fiducial, covariance in pairs}
    return found


def registrations_table(run: Inspection) -> RunTable:
    """Return one row per registration made. Raises REC-001, REC-003."""
    rows = []
    for stored in results_of(RegisteredRobot, run.records):
        name, one = stored.record.identifier, stored.result
        targets = " ".join(predicted.target for predicted in one.predictions)
        fit = (one.pairs, one.fre_mm, one.robot_from_ct.translation_mm, one.robot_from_ct.quaternion_wxyz)
        rows.append((name, targets, name not in run.superseded, *fit))
    return RunTable.of(REGISTRATIONS, rows)


def budget_table(run: Inspection) -> RunTable:
    """Return one row per target, registration and source of its predicted error. Raises REC-001, REC-003."""
    rows = []
    for stored in results_of(RegisteredRobot, run.records):
        name = stored.record.identifier
        for predicted in stored.result.predictions:
            origin = (predicted.target, name, name not in run.superseded)
            rows += [(*origin, share.source, share.rms_mm) for share in predicted.budget]
    return RunTable.of(BUDGET, rows)


def find_registration(reading: RunReading, target: str) -> UsedRegistration | None:
    """Return the registration used for a target, or None. Raises REC-001, REC-003."""
    results_of(RegisteredRobot, reading.run.records)
    return next((one for one in reading.registrations if target in one.targets), None)


def motions_table(journal: Sequence[Line]) -> RunTable:
    """Return one row per motion of an arm."""
    rows: list[list[Any]] = []
    step = ""
    moved = [line for line in journal if line["entry"] in (Entry.MOTION, Entry.MOVED)]
    goals: list[Any] = [line[field] for line in moved for field in ("to", "joints_rad") if field in line]
    axes = max((len(goal) for goal in goals if len(goal) != len(NOWHERE)), default=AXES)
    unknown = (math.nan,) * axes
    for line in journal:
        if line["entry"] in (Entry.INTENT, Entry.HOME):
            step = str(line.get("step", ""))
        elif line["entry"] == Entry.MOTION:
            goal: Any = line["to"]
            in_joints = len(goal) != len(NOWHERE)
            goal_rad = (*goal, *unknown[len(goal) :]) if in_joints else unknown
            begun = [line["number"], line.get("arm", ""), step, line["what"], theatre_time_s(line), math.nan]
            rows.append([*begun, goal_rad, NOWHERE if in_joints else tuple(goal), unknown, ""])
        elif line["entry"] == Entry.MOVED:
            joints: Any = line.get("joints_rad", unknown)
            motion = [line["number"], line.get("arm", "")]
            if (moved_row := next((row for row in reversed(rows) if row[:2] == motion), None)) is not None:
                moved_row[5], moved_row[9] = theatre_time_s(line), line.get("error", "")
                moved_row[8] = (*joints, *unknown[len(joints) :])
    return RunTable.of(_with_axes(MOTIONS, axes), rows)


def _with_axes(columns: tuple[RunColumn, ...], axes: int) -> tuple[RunColumn, ...]:
    """Give joints as many numbers as the arms of a run have axes."""
    return tuple(replace(one, size=(axes,)) if one.size == (AXES,) else one for one in columns)


def events_table(folder: Path) -> RunTable:
    """Return one row per event so far. Raises CLI-005 for a run without events, PRO-018 for damaged ones."""
    events = next(FollowedRun(folder).batches(whole=True))
    rows = []
    for one in events:
        host_time = np.datetime64(one.host_time.replace(tzinfo=None), "ms")
        content = (one.what.kind, getattr(one.what, "step", ""), one.what.model_dump_json(exclude={"kind"}))
        rows.append((one.number, one.theatre_time_s, host_time, *content))
    return RunTable.of(EVENTS, rows)
