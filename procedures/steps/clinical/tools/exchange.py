"""People exchange the tool on the parked arm; the controller's inputs show when the right one is mounted."""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.operator.question import YES, Topic
from procedures.steps.branches import MOUNTINGS, WRONG_TOOL
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from ronna_hw.calibration import STEREO_HEAD_NUMBER


def exchange_for(context: StepContext, tool: MountedTool) -> int:
    """End the correction stream and have a tool mounted until it is; its number. One already there stays on.

    Raises PRO-002, or PRO-009 when it is not mounted.
    """
    workcell = context.workcell
    workcell.rest()
    number, name = STEREO_HEAD_NUMBER, "the stereo head"
    if tool is MountedTool.GUIDE:
        number, name = workcell.calibrations.tool_tip.tool_number, "the surgical guide"
    value = f"{name}, tool {number}"
    if workcell.tool is tool:  # of an exchange that was interrupted: mounted again, it would lose its seat
        context.confirm(Topic.TOOL_CHANGE, "the tool is still mounted; leave it on", value)
    else:
        context.setting.room.change_tool(number, name)
        context.confirm(Topic.TOOL_CHANGE, "the tool has been exchanged", value)
    for mounting in range(1, MOUNTINGS + 1):
        try:
            return workcell.check_mounted(tool)
        except WrongTool as problem:
            if mounting == MOUNTINGS:
                raise
            context.setting.room.change_tool(number, name)
            again = WRONG_TOOL.question(
                "the wrong tool is mounted: mount again", f"{value}; {problem.summary}"
            )
            if context.choose(again) != YES:
                raise
    raise AssertionError("the last mounting has returned or raised")
