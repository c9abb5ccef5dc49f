"""Head clamping, confirmed by the operator and by the tracker's view of the spheres."""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.room_reading import FRAMES
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.operator.question import Task, Topic
from procedures.planning.plan_model import PatientPosition
from procedures.registration.movement import LEAST_POINTS
from procedures.registration.surface.errors import NO_PATIENT_FRAME
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import needs_arm_home
from procedures.workcell.patient_frame import require_in_view
from procedures.workcell.tracker_look import read_frames_at_rest
from ronna_hw.devices.strays import average_strays
from ronna_hw.wire.room_tasks import HEAD_CLAMP


class ClampedHead(StepResult, kind="head_clamp"):
    """The clamped head, and the spheres that the tracker sees on it."""

    patient_position: PatientPosition = Field(
        description="Patient position according to the plan, as confirmed."
    )
    spheres: int = Field(description="Spheres that the tracker sees.")
    implanted: int = Field(description="Number of spheres expected.")


def run(context: StepContext) -> Outcome[ClampedHead]:
    """Ask to clamp the head, then measure it. Raises PRO-002, or PRO-007 if head or frame is not visible.

    A head without markers is watched by the frame on the clamp alone: SRF-031 without one.
    """
    context.result(CheckedSetUp)
    checked = context.result(CheckedPlan)
    if not checked.implanted and context.workcell.patient_frame is None:
        raise NO_PATIENT_FRAME("this theatre has no frame on the head clamp")
    context.workcell.rest()  # hands are at the head: nothing may move the arm meanwhile
    table_orientation = checked.plan.table_orientation
    context.perform_task(
        Task(
            HEAD_CLAMP,
            f"clamp the head ({table_orientation}), lock the clamp to the table"
            + (", attach the spheres" if checked.implanted else ""),
        )
    )
    subject = "Is the head clamped, and the clamp locked to the table?"
    on_screws = f"{checked.implanted} spheres are on the screws" if checked.implanted else "no markers"
    value = f"patient position {table_orientation}; {on_screws}"
    context.confirm(Topic.HEAD_CLAMPED, subject, value)
    frames, _ = read_frames_at_rest(context.workcell, count=FRAMES)
    require_in_view(context.workcell, frames)
    seen = len(average_strays(frames).groups)
    if seen < min(LEAST_POINTS, checked.implanted):
        raise GateFailed(
            "the tracker sees too few spheres on the head",
            limit=f"at least {LEAST_POINTS}",
            got=str(seen),
            action="Turn the head or the tracker, clear the line of sight, then repeat the step.",
        )
    clamped = ClampedHead(patient_position=table_orientation, spheres=seen, implanted=checked.implanted)
    return Outcome(
        clamped,
        summary=f"{seen} spheres seen, {checked.implanted} implanted" if checked.implanted else "no markers",
    )


STEP = StepSpec(
    ClampedHead,
    "Clamp the head",
    Phase.PREPARATION,
    run,
    asks=(Topic.HEAD_CLAMPED,),
    reads=(CheckedSetUp, CheckedPlan),
    preconditions=needs_arm_home,
)
