"""The kinds of calibration, each with its looks, computation, records and figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from procedures.calibration import Baseline, CheckResult, HeadResult, ObservationSet, calibrate_head
from procedures.calibration.arm_calibration import ArmResult, calibrate_arm
from procedures.calibration.arm_model import LOOKS_FILE as ARM_LOOKS_FILE
from procedures.calibration.arm_model import ArmLooks
from procedures.calibration.errors import BAD_OBSERVATIONS, NotTheBaseline
from procedures.calibration.frame_calibration import LOOKS_FILE as FRAME_LOOKS_FILE
from procedures.calibration.frame_calibration import FrameLooks, FrameResult, calibrate_frame
from procedures.calibration.observations import (
    OBSERVATIONS_FILE,
    Measurements,
    read_strict,
    require_same_theatre,
)
from procedures.calibration.self_check import BASELINE_FILE
from procedures.calibration.tip_calibration import LOOKS_FILE as TIP_LOOKS_FILE
from procedures.calibration.tip_calibration import TipLooks, TipResult, calibrate_tip
from procedures.engine.case import Case
from procedures.engine.order import order_of
from procedures.reporting import calibration_figures
from procedures.runs.calibration_files import update_theatre, write_records
from procedures.runs.interrupted_run import InterruptedRun
from procedures.runs.reopening import close_completed_run
from procedures.runs.request import RunRequest
from procedures.runs.theatre_history import UpdateAuthor
from procedures.steps.calibration.frame_looks import ObservedFrame
from procedures.steps.calibration.head_looks import ObservedBall
from procedures.steps.calibration.recipe import Calibrated, Recipe
from procedures.steps.calibration.sphere_looks import ObservedSpheres
from procedures.steps.calibration.tip_readings import ObservedStand, TipReadings
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import DatedRecord
from ronna_hw.command_line.messages import tell
from ronna_hw.config import Calibrations, read_theatre_file
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.records import write_atomically

Looks = TypeVar("Looks", bound=Measurements)
Result = TypeVar("Result")
MOUNT_THE_HEAD = "the guide is on the arm: mount the stereo head before the next case"


@dataclass(frozen=True)
class CalibrationKind(Generic[Looks, Result]):
    """A kind of calibration: its looks, its computation, and the records that it produces.

    The looks, and remarks for the operator, stand in the results of two of its steps. `records`
    are fields of its result by their names in the theatre file; one that is None was not made. `in_use`
    selects the records for its steps from those of the theatre.

    OUT/<name>-<id>/<looks file>    the observations, kept before anything is computed, for `--from`
    """

    name: str
    title: str
    activity: str
    looks_type: type[Looks]
    looks_file: str
    observed_by: type[Any]
    compute: Callable[..., Result]
    records: tuple[str, ...]
    figures: Callable[[Result], calibration_figures.RecordFigures]
    remarked_by: type[Any] | None = None  # if not by the step that observed
    last_remark: str = ""
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre
    keep: Callable[[Looks, Result, Path], None] = lambda _looks, _result, _folder: None

    def observed(self, case: Case) -> Looks:
        """Return the looks taken by a completed calibration case."""
        looks: Looks = case.get(self.observed_by).result.observed
        return looks

    def remarks(self, case: Case) -> tuple[str, ...]:
        """Return the remarks for the operator from a completed calibration case."""
        remarks = case.get(self.remarked_by or self.observed_by).result.remarks
        return (*remarks, self.last_remark) if self.last_remark else tuple(remarks)

    def records_of(self, result: Result) -> dict[str, Any]:
        """Return the new records, keyed by their names in the theatre file."""
        made = {name: getattr(result, name) for name in self.records}
        return {
            name: record.model_dump(exclude_none=True) for name, record in made.items() if record is not None
        }

    def read_looks(self, path: Path) -> Looks:
        """Read stored looks from a file or its folder. Raises CAL-005; PRO-033 if their run was changed."""
        file = path / self.looks_file if path.is_dir() else path
        looks = read_strict(self.looks_type, file)
        if (file.parent / JOURNAL_FILE).exists():
            run = inspect_run(file.parent, every_file=False).require_account()
            run.require_content(file.name, read_json_bytes(file))
        return looks

    def write_looks(self, looks: Looks, folder: Path) -> None:
        """Save the looks before any computation."""
        write_atomically(folder / self.looks_file, looks.model_dump_json(by_alias=True, indent=1).encode())


def compute_calibration(kind: CalibrationKind[Looks, Result], request: RunRequest, looks: Looks) -> Result:
    """Compute a calibration from its looks. Raises CAL-020 for looks of another theatre."""
    theatre = None if request.config is None else read_theatre_file(request.config).calibration
    if theatre is not None:
        require_same_theatre(looks, theatre)  # a computation may take minutes
    try:
        result = kind.compute(looks, life=timedelta(days=request.calibration.days))
    except RonnaError:
        raise
    except (ValueError, ArithmeticError) as error:  # the former also of a matrix
        raise BAD_OBSERVATIONS(f"nothing can be computed from these measurements: {error}") from error
    if theatre is not None:
        require_same_theatre(looks, theatre, kind.records_of(result))
    return result


def write_calibration_files(
    kind: CalibrationKind[Looks, Result], request: RunRequest, looks: Looks, result: Result, folder: Path
) -> None:
    """Write the result files of a calibration and, if requested, update the theatre file."""
    kind.keep(looks, result, folder)
    write_records(kind.records_of(result), folder)
    calibration_figures.write_figures(kind.figures(result), folder)
    if request.calibration.update and request.config is not None:
        signature = UpdateAuthor(f"calibration {kind.name}", source=str(folder.resolve()))
        update_theatre(request.config, kind.records_of(result), looks.created, signature)


def conclude(kind: CalibrationKind[Looks, Result], request: RunRequest, case: Case, folder: Path) -> None:
    """Conclude a completed calibration: report its remarks, store its looks, compute, and write its files.

    Remarks come first: the computation may fail for the same reason.
    """
    for remark in kind.remarks(case):
        tell(remark)
    looks = kind.observed(case)
    kind.write_looks(looks, folder)
    write_calibration_files(kind, request, looks, compute_calibration(kind, request, looks), folder)


def finish_calibration(
    kind: CalibrationKind[Looks, Result], request: RunRequest, interrupted: InterruptedRun
) -> None:
    """Conclude an interrupted calibration whose looks are complete, without moving or querying any device."""
    case = interrupted.restore_case(order_of(Recipe.read(request.calibration.recipe).steps, ()))
    try:
        conclude(kind, request, case, interrupted.folder)
    except RonnaError as problem:
        close_completed_run(interrupted, None, "failed", code=problem.code, what=problem.what)
        raise
    close_completed_run(interrupted, None)


def has_every_look(request: RunRequest, interrupted: InterruptedRun) -> bool:
    """Whether an interrupted calibration has taken all its looks, leaving only the computation."""
    order = order_of(Recipe.read(request.calibration.recipe).steps, ())
    return not interrupted.untouched and all(map(interrupted.restore_case(order).stands, order.sequence))


def write_baseline(observed: ObservationSet, result: HeadResult, folder: Path) -> None:
    """Write the baseline for the stereo head check, or warn if the looks do not suffice."""
    baseline = Baseline(
        created=observed.created,
        stereo_head=result.stereo_head,
        arm_variant=observed.arm_variant,
        looks=tuple(look for look in observed.observations if look.orientation is not None),
    )
    try:
        baseline.require_complete()
    except NotTheBaseline as problem:
        tell(f"warning: ronna-stereo check cannot use this calibration: {problem.summary}")
        return
    write_atomically(folder / BASELINE_FILE, baseline.model_dump_json(by_alias=True, indent=1).encode())


def _dates(record: DatedRecord) -> dict[str, Any]:
    return dict(
        calibration=record.identifier, created=record.created.isoformat(), expires=record.expires.isoformat()
    )


def head_figures(result: HeadResult) -> calibration_figures.HeadFigures:
    """Return the figures of a stereo head calibration."""
    fit, head = result.fit, result.stereo_head
    return calibration_figures.HeadFigures(
        **_dates(head),
        serials=(head.left.serial, head.right.serial),
        poses=len(fit.used),
        outliers=tuple(np.flatnonzero(~fit.used).tolist()),
        image_sigma_px=fit.image_sigma_px,
        arm_error_mm=fit.arm_error_mm,
        arm_scatter_mm=fit.arm_scatter_mm,
        stated_error_mm=head.stated_error_mm,
        tool_error_mm=result.tool_error_mm,
        tool_covariance_mm2=result.tool_covariance_mm2.tolist(),
        tool_shift_mm=result.tool_shift_mm,
        frame_misfit_mm=result.frame_misfit_mm,
        smallest_slip_mm=result.smallest_slip_mm,
        head_moved=result.head_moved,
        ball_mm=fit.ball_mm.tolist(),
        flange_from_tool=head.flange_from_tool,
        residuals_px=fit.residuals_px.tolist(),
        shifts_mm=fit.shifts_mm.tolist(),
    )


def head_check_figures(result: CheckResult, baseline: Baseline) -> calibration_figures.HeadCheckFigures:
    """Return the figures of a stereo head check."""
    return calibration_figures.HeadCheckFigures(
        calibration=baseline.stereo_head.identifier,
        baseline_created=baseline.created.isoformat(),
        passed=result.passed,
        looks=result.looks,
        repeatability_mm=result.repeatability_mm,
        ball_moved_mm=result.ball_moved_mm,
        signs=tuple(map(calibration_figures.SignFigures.model_validate, result.signs)),
    )


STEREO_HEAD = CalibrationKind(
    name="stereo",
    title="Calibration of the stereo head",
    activity="measuring the ball",
    looks_type=ObservationSet,
    looks_file=OBSERVATIONS_FILE,
    observed_by=ObservedBall,
    compute=calibrate_head,
    records=("stereo_head", "tool_tip"),
    figures=head_figures,
    keep=write_baseline,
)


def arm_figures(result: ArmResult) -> calibration_figures.ArmFigures:
    """Return the figures of an arm calibration."""
    fit, held = result.fit, result.validation
    return calibration_figures.ArmFigures(
        **_dates(result.arm),
        arm=result.arm.arm,
        looks=len(fit.used),
        outliers=int((~fit.used).sum()),
        validation_looks=len(held.misses_mm),
        before_mm=held.before_mm,
        error_mm=held.error_mm,
        predicted_mm=held.predicted_mm,
        model_mm=held.model_mm,
        scatter_mm=fit.scatter_mm,
        tool_shift_mm=result.tool_shift_mm,
        parameters={
            name: calibration_figures.ParameterFigures(value=value, standard_error=error)
            for name, value, error in zip(fit.model.names, fit.values, fit.learnt, strict=False)
        },
    )


ARM = CalibrationKind(
    name="arm",
    title="Calibration of the arm",
    activity="measuring the spheres",
    looks_type=ArmLooks,
    looks_file=ARM_LOOKS_FILE,
    observed_by=ObservedSpheres,
    compute=calibrate_arm,
    records=("arm", "stereo_head", "tool_tip"),
    figures=arm_figures,
    # An arm is identified from its nominal geometry.
    in_use=lambda of_theatre: of_theatre.model_copy(update={"arm": None}),
)


def frame_figures(result: FrameResult) -> calibration_figures.FrameFigures:
    """Return the figures of a reference frame calibration."""
    fit, record = result.fit, result.tracker_frame
    return calibration_figures.FrameFigures(
        **_dates(record),
        frame=record.tool,
        poses=len(fit.used),
        outliers=int((~fit.used).sum()),
        validation_poses=len(result.misses_mm),
        tool_from_marker=record.tool_from_marker,
        flange_from_marker=fit.flange_from_marker.tolist(),
        error_mm=fit.error_mm,
        error_rad=fit.error_rad,
        arm_error_mm=result.arm_error_mm,
        stated_error_mm=record.stated_error_mm,
        scatter_mm=fit.scatter_mm,
        scatter_rad=fit.scatter_rad,
        validation_mm=_rms(result.misses_mm.tolist()),
        validation_rad=_rms(result.misses_rad.tolist()),
        predicted_mm=result.predicted_mm,
        predicted_rad=result.predicted_rad,
        change_mm=result.change_mm,
        change_rad=result.change_rad,
    )


def _rms(misses: list[list[float]]) -> float:
    return math.sqrt(sum(math.hypot(*miss) ** 2 for miss in misses) / len(misses))


TRACKER_FRAME = CalibrationKind(
    name="tracker-frame",
    title="Calibration of the reference frame",
    activity="turning the reference frame",
    looks_type=FrameLooks,
    looks_file=FRAME_LOOKS_FILE,
    observed_by=ObservedFrame,
    compute=calibrate_frame,
    records=("tracker_frame",),
    figures=frame_figures,
)


def tip_figures(result: TipResult) -> calibration_figures.TipFigures:
    """Return the figures of a tool tip calibration."""
    fit, record = result.fit, result.tool_tip
    return calibration_figures.TipFigures(
        **_dates(record),
        tool_number=record.tool_number,
        readings=len(fit.misses_mm),
        validation_readings=len(result.misses_mm),
        tip_in_head_mm=fit.tip_mm.tolist(),
        flange_from_tool=record.flange_from_tool,
        error_mm=math.sqrt(float(fit.covariance_mm2.trace())),
        stated_error_mm=record.stated_error_mm,
        stated_direction_error_rad=record.stated_direction_error_rad,
        reading_scatter_mm=fit.scatter_mm,
        validation_mm=_rms(result.misses_mm.tolist()),
        predicted_mm=result.predicted_mm,
        gap_mm=fit.gap_mm.tolist(),
        gap_error_mm=fit.gap_error_mm,
        change_mm=result.change_mm,
    )


TOOL_TIP = CalibrationKind(
    name="tool-tip",
    title="Calibration of the guide's tip",
    activity="measuring the ball, reading the divot",
    looks_type=TipLooks,
    looks_file=TIP_LOOKS_FILE,
    observed_by=TipReadings,
    remarked_by=ObservedStand,
    last_remark=MOUNT_THE_HEAD,
    compute=calibrate_tip,
    records=("tool_tip",),
    figures=tip_figures,
)


KINDS: dict[Calibrated, CalibrationKind[Any, Any]] = {
    Calibrated.HEAD: STEREO_HEAD,
    Calibrated.ARM: ARM,
    Calibrated.FRAME: TRACKER_FRAME,
    Calibrated.TIP: TOOL_TIP,
}
