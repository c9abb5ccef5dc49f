"""Read the plan and hold it against the CT and the spheres that were found in it."""

from __future__ import annotations

import json

from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.imaging.series import read_series
from procedures.planning.check import check_plan
from procedures.planning.head_shape import head_shape
from procedures.planning.plan import Plan, PlannedTrajectory
from procedures.planning.plan_file import read_plan
from procedures.steps.ct_import import VOLUME
from procedures.steps.payloads import points_from


def run(context: StepContext) -> Outcome:
    """Check the plan; raises PLAN-00x with everything that is wrong."""
    localization = context.case.get("fiducial_localization")
    plan = read_plan(context.case.plan)
    volume = context.workspace.get(VOLUME) or read_series(context.case.series)
    centres = points_from([marker["centre_mm"] for marker in localization.payload["markers"]])
    check = check_plan(plan, volume, fiducials_mm=centres)
    check.require()
    head = head_shape(volume)
    summary = f"{len(plan.trajectories)} trajectories, {plan.implanted} spheres implanted"
    context.workspace.pop(VOLUME, None)  # the largest input is not needed after this
    return Outcome(
        payload={
            "plan": plan.model_dump(mode="json", by_alias=True),
            "implanted": plan.implanted,
            "head": head.as_payload(),
            "warnings": list(check.warnings),
        },
        parents=(context.case.get("ct_import"), localization),
        summary="; ".join((summary, *check.warnings)),
    )


def planned(context: StepContext) -> Plan:
    """The plan as it was checked."""
    return Plan.model_validate_json(json.dumps(context.case.get("plan_check").payload["plan"]))


def trajectory_of(context: StepContext) -> PlannedTrajectory:
    """The planned trajectory of a step that belongs to one."""
    return planned(context).trajectory(str(context.key.trajectory))


STEP = StepSpec("plan_check", "Check the plan", needs=("ct_import", "fiducial_localization"), run=run)
