"""Retreat along the axis once the instrument is out, then parking."""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import LinkHealth, assistant_link_health, link_health
from procedures.steps.conditions import needs_insertion_or_withdrawal
from ronna_hw.vectors import JointVector


class Retreated(StepResult, kind="retreat", version=2):
    """State after the retreat: the guide is away from the head and the arm is home."""

    joints_rad: JointVector = Field(description="Measured joints at home.")
    link: LinkHealth = Field(description="Health of the robot link when it was closed.")
    assistant_link: LinkHealth | None = Field(
        default=None, description="Health of the assistant's link; none without one."
    )


def run(context: StepContext) -> Outcome[Retreated]:
    """Withdraw the guide along the trajectory, then go home."""
    workcell = context.workcell
    # The surroundings remain those of the way in. No record is read before the guide is away from the head: a
    # damaged file must not keep it there.
    if workcell.master.place.is_on_axis:
        context.request_instrument_removal()
        workcell.start()
        workcell.master.retreat(context.trajectory)
    context.result(PositionedGuide)
    context.result(ReachedTarget)
    workcell.start()
    reached = workcell.master.park()
    link, other = link_health(context, workcell.master), assistant_link_health(context)
    workcell.rest()
    return Outcome(Retreated(joints_rad=reached.joints_rad, link=link, assistant_link=other), "parked")


STEP = StepSpec(
    Retreated,
    "Retreat along the axis",
    Phase.OPERATION,
    run,
    asks=(Topic.RETREAT, Topic.PARK),
    scope=Scope.TRAJECTORY,
    reads=(PositionedGuide, ReachedTarget),
    moves=True,
    continues=True,
    preconditions=needs_insertion_or_withdrawal,
)
