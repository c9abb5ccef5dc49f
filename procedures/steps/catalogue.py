"""All steps of the procedure, in the order of their first use."""

from __future__ import annotations

from procedures.engine.step import StepSpec
from procedures.steps import (
    at_target,
    correspondence,
    ct_import,
    fiducial_localization,
    global_localization,
    path_check,
    plan_check,
    positioning,
    registration,
    relocalization,
    retreat,
    set_up,
    tool_change,
)

STEPS: dict[str, StepSpec] = {
    module.STEP.name: module.STEP
    for module in (
        ct_import,
        fiducial_localization,
        plan_check,
        set_up,
        global_localization,
        correspondence,
        path_check,
        relocalization,
        registration,
        tool_change,
        positioning,
        at_target,
        retreat,
    )
}
