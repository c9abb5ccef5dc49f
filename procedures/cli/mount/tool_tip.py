"""A calibration of the guide's tip: what is observed for it, and the figures that it leaves."""

from __future__ import annotations

import math
from typing import Any

from procedures.calibration.tip_calibration import LOOKS_FILE, TipLooks, TipResult, calibrate_tip
from procedures.cli.calibrating.calibration import CalibrationKind
from procedures.reporting.calibration_figures import TipFigures
from procedures.steps.calibration.tip_readings import ObservedStand, ReadTip

MOUNT_THE_HEAD = "the guide is on the arm: mount the stereo head before the next case"


def records_of(result: TipResult) -> dict[str, Any]:
    """The new record by the name that the theatre file has for it."""
    return {"tool_tip": result.tool_tip.model_dump()}


def figures_of(result: TipResult) -> TipFigures:
    """The figures of a calibration."""
    fit, record = result.fit, result.tool_tip
    missed = [math.hypot(*one) ** 2 for one in result.misses_mm.tolist()]
    return TipFigures(
        calibration=record.identifier,
        created=record.created.isoformat(),
        expires=record.expires.isoformat(),
        tool_number=record.tool_number,
        readings=len(fit.misses_mm),
        validation_readings=len(missed),
        tip_in_head_mm=fit.tip_mm.tolist(),
        flange_from_tool=record.flange_from_tool,
        error_mm=math.sqrt(float(fit.covariance_mm2.trace())),
        stated_error_mm=record.stated_error_mm,
        stated_direction_error_rad=record.stated_direction_error_rad,
        reading_scatter_mm=fit.scatter_mm,
        validation_mm=math.sqrt(sum(missed) / len(missed)),
        predicted_mm=result.predicted_mm,
        gap_mm=fit.gap_mm.tolist(),
        gap_error_mm=fit.gap_error_mm,
        change_mm=result.change_mm,
    )


KIND = CalibrationKind(
    name="tool-tip",
    title="Calibration of the guide's tip",
    activity="measuring the ball, reading the divot",
    looks_type=TipLooks,
    looks_file=LOOKS_FILE,
    observed=lambda case: case.get(ReadTip).result.observed,
    remarks=lambda case: (*case.get(ObservedStand).result.remarks, MOUNT_THE_HEAD),
    compute=lambda looks, life: calibrate_tip(looks, life=life),
    records=records_of,
    figures=figures_of,
)
