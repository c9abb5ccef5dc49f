"""Results of a run for export: its CT and as much else as it reached, under exported labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

from procedures.engine.case import results_of
from procedures.engine.run_folder import targets_in_doubt
from procedures.exchange import trajectory_lines
from procedures.exchange.allowed_fields import label_of
from procedures.exchange.case_spheres import CaseSpheres
from procedures.exchange.errors import NOTHING_TO_EXPORT
from procedures.exchange.export_tables import CT_FROM_ROBOT, CtIdentity, format_table
from procedures.journal.results import StepResult
from procedures.planning.plan_model import PlannedTrajectory
from procedures.postoperative.comparison import FoundTrajectory
from procedures.postoperative.summary import PostoperativeCheck
from procedures.reporting import run_reading
from procedures.reporting.ending import Ending, ending_of
from procedures.reporting.files import load_check
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.reporting.tables import TargetTable, target_rows
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import Prediction, RegisteredRobot, Relocalization
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.target_measurement import MeasuredTarget
from ronna_hw.evidence.inspection import Inspection

R = TypeVar("R", bound=StepResult)
FindTruth = Callable[[Path], Truth | None]
LEAVE_OUT: tuple[type[StepResult], ...] = (Correspondence, CheckedPaths, Relocalization, RegisteredRobot)

REGISTRATION_OF, REACHED_LINE_OF = "registration of ", "reached line of "  # a trajectory that lacks it


@dataclass(frozen=True)
class CaseResults:
    """Results of a case, finished or not; trajectories are keyed by their name in the plan."""

    run: Inspection
    ending: Ending
    ct: CtIdentity
    spheres: CaseSpheres | None
    plan: CheckedPlan | None
    registrations: tuple[run_reading.UsedRegistration, ...]
    reached: Mapping[
        str, trajectory_lines.TrajectoryLine | None
    ]  # None: the work was finished on an earlier visit
    check: PostoperativeCheck | None  # after the operation
    targets: TargetTable  # as the report has it
    truth: Mapping[str, TargetTruth]
    labels: Mapping[str, str]
    unreadable: str = ""  # why the check after the operation is missing

    @property
    def found(self) -> dict[str, FoundTrajectory]:
        """Trajectories found in the CT after the operation."""
        return {} if self.check is None else {one.id: one for one in self.check.trajectories}

    @property
    def lines(self) -> list[trajectory_lines.TrajectoryLine]:
        """All lines, trajectory by trajectory."""
        if self.plan is None:
            return []
        lines = []
        for one in self.plan.plan.trajectories:
            label = self.labels[one.id]
            lines.append(trajectory_lines.planned_line(label, one))
            if (reached := self.reached.get(one.id)) is not None:
                lines.append(reached)
            if (found := self.found.get(one.id)) is not None:
                lines.append(trajectory_lines.found_line(label, found))
        return lines

    @property
    def simulated(self) -> bool:
        """Whether the theatre was simulated: only there is the true error known."""
        return bool(self.run.opened.get("banner"))

    def absent(self) -> dict[str, str]:
        """Map missing results to reasons."""
        ended = f"the run ended before: {self.ending.word}"
        missing: dict[str, str] = {}
        if self.spheres is None:
            missing["spheres"] = ended
        elif not self.spheres.numbered:
            missing["spheres"] = "there are none: the case registers on the skin"
        if self.plan is None:
            return missing | {"plan, trajectories and errors": ended}
        names = [one.id for one in self.plan.plan.trajectories]
        registered = {name for one in self.registrations for name in one.targets}
        left_out = self._left_out()
        for what, present in ((REGISTRATION_OF, registered), (REACHED_LINE_OF, self.reached)):
            for name in names:
                if name not in present:
                    missing[f"{what}{self.labels[name]}"] = "left out" if name in left_out else ended
        for name, line in self.reached.items():
            if line is None:
                missing[f"{REACHED_LINE_OF}{self.labels[name]}"] = (
                    "the pose of the guide is not in its record"
                )
        if not self.found:
            missing["found lines"] = self.unreadable or (
                "no CT after the operation was compared: "
                "ronna-ct postoperative PRE POST --plan PLAN --run RUN"
            )
        if not self.simulated:
            missing["true errors"] = "known only in a simulated theatre"
        elif unknown := [self.labels[name] for name in names if name not in self.truth]:
            missing[f"true error of {', '.join(unknown)}"] = (
                "no tip was sampled there in the simulated theatre"
            )
        return missing

    def tabulate_errors(self) -> str:
        """Format the table of errors, with a row for each planned trajectory."""
        if self.plan is None:
            return format_table("errors.csv", ())
        doubts, left_out = targets_in_doubt(self.run.journal), self._left_out()
        strategies = run_reading.find_used_strategies(results_of(CheckedPaths, self.run.records))
        predicted = {
            one.target: describe_prediction(one) for used in self.registrations for one in used.predictions
        }
        stereo_mm = {
            one.record.trajectory: one.result.error_mm
            for one in results_of(MeasuredTarget, self.run.valid_records)
        }
        rows = []
        for one in self.plan.plan.trajectories:
            name, state = one.id, "reached" if one.id in self.reached else "not reached"
            if name in left_out and name not in self.reached:
                state = "left out"
            row: dict[str, object] = {"trajectory": self.labels[name], "state": state}
            row |= {"in_doubt": int(name in doubts), "strategy": strategies.get(name)}
            row |= {"depth_mm": one.depth_mm, "margin_mm": one.margin_mm, **predicted.get(name, {})}
            row |= _columns("nominal", self.reached.get(name), one)
            row |= {"stereo_error_mm": stereo_mm.get(name), **_columns("found", self.found.get(name), one)}
            row |= _columns("simulated", self.truth.get(name), one)
            rows.append(row | self.ct.describe(CT_FROM_ROBOT))
        return format_table("errors.csv", rows)

    def _left_out(self) -> set[str]:
        return {
            name
            for model in LEAVE_OUT
            for one in results_of(model, self.run.valid_records)
            for name in one.result.leaves_out()
        }


def read_results(reading: run_reading.RunReading, find_truth: FindTruth) -> CaseResults:
    """Read what a run has for an export.

    `find_truth` asks the simulated theatre of a run without a stored truth. Raises EXC-003 for a run without
    a CT, REC-001, REC-003.
    """
    run = reading.run
    imported = results_of(ImportedCt, run.valid_records)
    if not imported:
        raise NOTHING_TO_EXPORT(
            f"{run.name} has no CT: it is no case, or it ended before its CT was imported",
            expected="a case that imported its CT",
            got=f"a run without, {ending_of(reading).word}",
        )
    ct = imported[-1].result
    plan = _last(run, CheckedPlan)
    registrations = run_reading.find_used_registrations(
        results_of(RegisteredRobot, run.records), run.records, run.superseded
    )
    planned = [] if plan is None else [one.id for one in plan.plan.trajectories]
    names = dict.fromkeys([*planned, *(name for one in registrations for name in one.targets)])
    labels = {name: label_of(name, number) for number, name in enumerate(names, 1)}
    after = load_check(reading)
    truth = (reading.truth or find_truth(run.folder)) if run.opened.get("banner") else None
    return CaseResults(
        run=run,
        ending=ending_of(reading),
        ct=CtIdentity(ct.series_instance_uid, ct.frame_of_reference_uid, ct.study_instance_uid),
        spheres=CaseSpheres.of(run.valid_records),
        plan=plan,
        registrations=registrations,
        reached=reached_lines(run, plan, registrations, labels),
        check=None if after is None else after.found,
        targets=TargetTable(target_rows(reading, truth or Truth())),
        truth={} if truth is None else {one.id: one for one in truth.targets},
        labels=labels,
        unreadable="; ".join(reading.problems),
    )


def reached_lines(
    run: Inspection,
    plan: CheckedPlan | None,
    registrations: Sequence[run_reading.UsedRegistration],
    labels: Mapping[str, str],
) -> dict[str, trajectory_lines.TrajectoryLine | None]:
    """Return the line of each reached trajectory; None where the work was finished on an earlier visit."""
    set_up = _last(run, CheckedSetUp)
    tool = None if plan is None or set_up is None else set_up.tools.get(plan.plan.tool)
    poses = {name: one.result.robot_from_ct_at(name) for one in registrations for name in one.targets}
    lines: dict[str, trajectory_lines.TrajectoryLine | None] = {}
    for one in results_of(ReachedTarget, run.valid_records):
        name, pose, stop = one.record.trajectory, one.result.tool_pose, one.result.depth_stop
        if plan is None or name is None or name not in labels:
            continue
        lines[name] = None
        if pose is not None and tool is not None and tool.bore is not None and name in poses:
            lines[name] = trajectory_lines.reached_line(
                labels[name], plan.trajectory(name), pose.transform, poses[name], stop, tool.bore
            )
    return lines


def _last(run: Inspection, model: type[R]) -> R | None:
    found = results_of(model, run.valid_records)
    return found[-1].result if found else None


def describe_prediction(prediction: Prediction) -> dict[str, float]:
    """Return the exported fields of a predicted error."""
    return {
        "predicted_tre_mm": prediction.rms_mm,
        "predicted_tre_limit_mm": prediction.limit_mm,
        "confidence": prediction.confidence,
    }


def _columns(
    source: str,
    tip: trajectory_lines.TrajectoryLine | FoundTrajectory | TargetTruth | None,
    planned: PlannedTrajectory,
) -> dict[str, float | None]:
    """Return the deviation of a tip from its planned target as columns; none without a tip."""
    match tip:
        case trajectory_lines.TrajectoryLine():
            error = trajectory_lines.deviation(tip, planned)
        case FoundTrajectory():
            error = trajectory_lines.Deviation(tip.target_error_mm, tip.lateral_mm, tip.depth_error_mm)
        case TargetTruth():
            error = trajectory_lines.Deviation(tip.application_error_mm, tip.lateral_mm, tip.axial_mm)
        case None:
            return {}
    return {f"{source}_{name}": value for name, value in asdict(error).items()}
