"""The clinical steps, in the order of a case. A new step is one new module and its entry here."""

from __future__ import annotations

from procedures.engine.order import Steps
from procedures.steps.clinical import (
    at_target,
    cart_lock,
    confirmation,
    correspondence,
    ct_import,
    fiducial_localization,
    global_localization,
    head_clamp,
    path_check,
    plan_check,
    positioning,
    registration,
    relocalization,
    retreat,
    set_up,
    target_measurement,
    tool_change,
    tool_check,
)

CLINICAL_STEPS: Steps = (
    ct_import.STEP,
    fiducial_localization.STEP,
    plan_check.STEP,
    set_up.STEP,
    head_clamp.STEP,
    cart_lock.STEP,
    global_localization.IN_CASE,
    correspondence.STEP,
    path_check.STEP,
    relocalization.STEP,
    registration.STEP,
    tool_change.STEP,
    tool_check.STEP,
    positioning.STEP,
    at_target.STEP,
    retreat.STEP,
    confirmation.STEP,
)


def clinical_steps(*, measure_targets: bool = False) -> Steps:
    """The steps of a case; on a phantom, those that measure the targets come before the exchange of tools."""
    if not measure_targets:
        return CLINICAL_STEPS
    place = CLINICAL_STEPS.index(tool_change.STEP)
    return (*CLINICAL_STEPS[:place], target_measurement.STEP, *CLINICAL_STEPS[place:])
