"""A calibration of the arm: what is observed for it, and the figures that it and its check leave."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from procedures.calibration.arm_calibration import ArmResult, calibrate_arm
from procedures.calibration.arm_model import LOOKS_FILE, ArmLooks
from procedures.cli.calibrating.calibration import CalibrationKind
from procedures.reporting.calibration_figures import ArmFigures, ParameterFigures
from procedures.steps.calibration.sphere_looks import ObservedSpheres
from ronna_hw.config import Calibrations


def records_of(result: ArmResult) -> dict[str, Any]:
    """The new records by the names that the theatre file has for them."""
    records = {"arm": result.arm, "stereo_head": result.stereo_head, "tool_tip": result.tool_tip}
    given = {name: record for name, record in records.items() if record is not None}
    return {name: record.model_dump(exclude_none=True) for name, record in given.items()}


def figures_of(result: ArmResult) -> ArmFigures:
    """The figures of a calibration."""
    fit, held = result.fit, result.validation
    return ArmFigures(
        calibration=result.arm.identifier,
        created=result.arm.created.isoformat(),
        expires=result.arm.expires.isoformat(),
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
            name: ParameterFigures(value=value, standard_error=error)
            for name, value, error in zip(fit.model.names, fit.values, fit.learnt, strict=False)
        },
    )


def without_arm(of_theatre: Calibrations) -> Calibrations:
    """An arm is identified from its nominal geometry, whatever a former record says."""
    return of_theatre.model_copy(update={"arm": None})


KIND = CalibrationKind(
    name="arm",
    title="Calibration of the arm",
    activity="measuring the spheres",
    looks_type=ArmLooks,
    looks_file=LOOKS_FILE,
    observed=lambda case: case.get(ObservedSpheres).result.observed,
    remarks=lambda case: case.get(ObservedSpheres).result.remarks,
    compute=lambda looks, life: calibrate_arm(looks, life=life),
    records=records_of,
    figures=figures_of,
    in_use=without_arm,
)
CHECK = replace(KIND, title="Check of the arm", in_use=lambda of_theatre: of_theatre)
