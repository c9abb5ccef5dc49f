"""The clinical steps, in the order of a case. A new step is one new module and one line here."""

from __future__ import annotations

from procedures.engine.order import Steps
from procedures.steps.clinical import (
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

CLINICAL_STEPS: Steps = (
    ct_import.STEP,
    fiducial_localization.STEP,
    plan_check.STEP,
    set_up.STEP,
    global_localization.STEP,
    correspondence.STEP,
    path_check.STEP,
    relocalization.STEP,
    registration.STEP,
    tool_change.STEP,
    positioning.STEP,
    at_target.STEP,
    retreat.STEP,
)
