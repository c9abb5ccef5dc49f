"""Exchange of the stereo head for the guide, with the arm parked and its correction stream off."""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.steps.clinical.results import LinkHealth, assistant_link_health, link_health
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.clinical.tool_mounting import exchange_tool
from procedures.steps.conditions import needs_exchangeable_tool
from procedures.workcell import MountedTool


class MountedGuide(StepResult, kind="tool_change"):
    """The guide found on the mount."""

    tool_number: int = Field(description="As the controller's inputs report it.")
    calibration: str = Field(description="Name of the tip calibration in use.")
    link: LinkHealth = Field(description="Health of the robot link while the stereo head was mounted.")
    assistant_link: LinkHealth | None = Field(
        default=None, description="Health of the assistant's link meanwhile; none without one."
    )


def run(context: StepContext) -> Outcome[MountedGuide]:
    """Park, end the stream, ask for the tool change, and identify the tool from the controller's inputs."""
    workcell, calibration = context.workcell, context.workcell.calibrations.tool_tip
    context.result(CheckedSetUp)
    if (
        workcell.master.mount.identify() is MountedTool.STEREO_HEAD
        or workcell.master.streaming
        or not workcell.master.place.is_home
    ):
        _park(context)  # else an exchange was begun, and not ended
    link, other = link_health(context, workcell.master), assistant_link_health(context)
    mounted = exchange_tool(context, MountedTool.GUIDE)
    context.confirm(
        Topic.TOOL_TIP,
        "Use this tip calibration of the guide?",
        f"{calibration.identifier}, made {calibration.created:%Y-%m-%d}, "
        f"stated error {calibration.stated_error_mm:.2f} mm",
    )
    return Outcome(
        MountedGuide(
            tool_number=mounted, calibration=calibration.identifier, link=link, assistant_link=other
        ),
        summary=f"the surgical guide is mounted (tool {mounted})",
    )


def _park(context: StepContext) -> None:
    workcell = context.workcell
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    surround_stereo_head(context, workcell.master.joints_rad())
    check_room(context, "before the arm parks")
    workcell.start()
    workcell.master.park("for the tool exchange")
    check_room(context, "with the arm parked for the tool exchange", CAREFUL_FRAMES)


STEP = StepSpec(
    MountedGuide,
    "Exchange the stereo head for the guide",
    Phase.OPERATION,
    run,
    asks=(Topic.PARK, Topic.TOOL_CHANGE, Topic.TOOL_TIP),
    reads=(CheckedSetUp, *ROOM_READS, *READS),
    moves=True,
    preconditions=needs_exchangeable_tool,
)
