"""A calibration of the reference frame: what is observed for it, and the figures that it leaves."""

from __future__ import annotations

import math
from typing import Any

from procedures.calibration.frame_calibration import LOOKS_FILE, FrameLooks, FrameResult, calibrate_frame
from procedures.cli.calibrating.calibration import CalibrationKind
from procedures.reporting.calibration_figures import FrameFigures
from procedures.steps.calibration.frame_looks import ObservedFrame


def records_of(result: FrameResult) -> dict[str, Any]:
    """The new record by the name that the theatre file has for it."""
    return {"tracker_frame": result.tracker_frame.model_dump()}


def figures_of(result: FrameResult) -> FrameFigures:
    """The figures of a calibration."""
    fit, record = result.fit, result.tracker_frame
    return FrameFigures(
        calibration=record.identifier,
        created=record.created.isoformat(),
        expires=record.expires.isoformat(),
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
    return math.sqrt(sum(math.hypot(*one) ** 2 for one in misses) / len(misses))


KIND = CalibrationKind(
    name="tracker-frame",
    title="Calibration of the reference frame",
    activity="turning the reference frame",
    looks_type=FrameLooks,
    looks_file=LOOKS_FILE,
    observed=lambda case: case.get(ObservedFrame).result.observed,
    remarks=lambda case: case.get(ObservedFrame).result.remarks,
    compute=lambda looks, life: calibrate_frame(looks, life=life),
    records=records_of,
    figures=figures_of,
)
