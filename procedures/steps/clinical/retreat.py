"""Retreat along the axis, then park. An instrument is out before."""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.journal.results import Numbers6, StepResult
from procedures.operator.question import Topic
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.conditions import inserted_or_just_out
from procedures.steps.link_health import LinkHealth, link_health
from procedures.workcell.parking import park, withdraw


class Retreated(StepResult, kind="retreat", version=2):
    """The guide is away from the head, and the arm home."""

    joints_rad: Numbers6 = Field(description="Measured joints at home.")
    link: LinkHealth = Field(description="Health of the robot link when it was closed.")


def run(context: StepContext) -> Outcome[Retreated]:
    """Back out along the trajectory, then to the pose where the case began."""
    workcell = context.workcell
    # The surroundings are those of the way in. No record is read before the guide is away from the head: a
    # damaged file must not keep it there.
    if (on := workcell.place.axis) is not None:
        context.have_instrument_out()
        withdraw(workcell, on, context.trajectory)
    context.result(PositionedGuide)
    context.result(ReachedTarget)
    reached = park(workcell)
    link = link_health(context)
    workcell.rest()
    return Outcome(Retreated(joints_rad=reached.joints_rad, link=link), "parked")


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
    preconditions=inserted_or_just_out,
)
