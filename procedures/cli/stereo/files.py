"""A calibration of the stereo head: what is observed for it, and what it writes besides looks and records.

OUT/<id>/baseline.json       the eight orientations of the self-check, for `ronna-stereo check`, if complete
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from procedures.calibration import Baseline, CheckResult, HeadResult, ObservationSet, calibrate_head
from procedures.calibration.errors import NotTheBaseline
from procedures.calibration.observations import OBSERVATIONS_FILE
from procedures.calibration.self_check import BASELINE_FILE
from procedures.cli.calibrating.calibration import CalibrationKind
from procedures.reporting.calibration_figures import HeadCheckFigures, HeadFigures, SignFigures
from procedures.steps.calibration.head_looks import ObservedBall
from ronna_hw.command_line.messages import tell
from ronna_hw.records import write_whole


def write_baseline(observed: ObservationSet, result: HeadResult, folder: Path) -> None:
    """Keep the looks of the self-check and the head that they belong to, unless too few were taken."""
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
    write_whole(folder / BASELINE_FILE, baseline.model_dump_json(by_alias=True, indent=1).encode())


def records_of(result: HeadResult) -> dict[str, Any]:
    """The new records by the names that the theatre file has for them."""
    records = {"stereo_head": result.stereo_head.model_dump()}
    if result.tool_tip is not None:
        records["tool_tip"] = result.tool_tip.model_dump()
    return records


def figures_of(result: HeadResult) -> HeadFigures:
    """The figures of a calibration."""
    fit, head = result.fit, result.stereo_head
    return HeadFigures(
        calibration=head.identifier,
        created=head.created.isoformat(),
        expires=head.expires.isoformat(),
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


def check_figures(result: CheckResult, baseline: Baseline) -> HeadCheckFigures:
    """The figures of a check."""
    return HeadCheckFigures(
        calibration=baseline.stereo_head.identifier,
        baseline_created=baseline.created.isoformat(),
        passed=result.passed,
        looks=result.looks,
        repeatability_mm=result.repeatability_mm,
        ball_moved_mm=result.ball_moved_mm,
        signs=tuple(map(SignFigures.model_validate, result.signs)),
    )


KIND = CalibrationKind(
    name="stereo",
    title="Calibration of the stereo head",
    activity="measuring the ball",
    looks_type=ObservationSet,
    looks_file=OBSERVATIONS_FILE,
    observed=lambda case: case.get(ObservedBall).result.observed,
    remarks=lambda case: case.get(ObservedBall).result.remarks,
    compute=lambda looks, life: calibrate_head(looks, life=life),
    records=records_of,
    figures=figures_of,
    keep=write_baseline,
)
