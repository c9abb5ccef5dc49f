"""Mounted tool: manual exchange on the parked arm, and position check by tracker.

The controller's inputs show whether the right tool is mounted. The tracker compares the frame on the tool
with frame M on the mount in the same readings. So arm, tracker position and calibrations do not matter. This
gross check precedes any motion: a longer tool would hit the gauge.
"""

from __future__ import annotations

import numpy as np

from procedures.engine.context import StepContext
from procedures.guards.room_watch import RoomLook
from procedures.operator.question import YES, Topic
from procedures.steps.branches import MOUNTINGS, WRONG_TOOL
from procedures.steps.errors import ToolSeenElsewhere
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from procedures.workcell.tracker_look import mean_pose
from ronna_hw.calibration import STEREO_HEAD_NUMBER
from ronna_hw.frames import Frame
from ronna_hw.text import format_against_limit
from ronna_hw.tool_record import ToolFrame

# Safety against a tool that is not the one it is taken for (U).
SEEN_LIMIT_MM = 1.0  # of any sphere on the tool: above the tracker's error; the gauge finds the rest


def exchange_tool(context: StepContext, tool: MountedTool) -> int:
    """End the stream, request a tool unless it is already mounted, and return its number.

    Raises PRO-002, or PRO-009 if it is not mounted in the end.
    """
    workcell = context.workcell
    workcell.rest()
    number, name = STEREO_HEAD_NUMBER, "the stereo head"
    if tool is MountedTool.GUIDE:
        number, name = workcell.calibrations.tool_tip.tool_number, "the surgical guide"
    value = f"{name}, tool {number}"
    if workcell.master.tool is tool:  # after an interrupted exchange: remounting would change its seat
        context.confirm(Topic.TOOL_CHANGE, "Is the tool still mounted? Leave it on.", value)
    else:
        context.setting.room.change_tool(number, name)
        context.confirm(Topic.TOOL_CHANGE, "Has the tool been exchanged?", value)
    for mounting in range(1, MOUNTINGS + 1):
        try:
            return workcell.master.mount.check(tool)
        except WrongTool as problem:
            if mounting == MOUNTINGS:
                raise
            context.find(f"the wrong tool is mounted: mount again {value}; {problem.summary}")
            context.setting.room.change_tool(number, name)
            if context.choose(WRONG_TOOL.question("Has the tool been exchanged again?", value)) != YES:
                raise
    raise AssertionError("the last mounting has returned or raised")


def require_seen_in_place(
    context: StepContext, frame: ToolFrame, look: RoomLook, *, must_see: bool = True
) -> float | None:
    """Return the largest deviation (mm) of the tool's spheres from their recorded positions. Raises TOOL-006.

    None if a frame is hidden in this look and `must_see` is not set.
    """
    workcell = context.workcell
    reference, frames = workcell.calibrations.tracker_frame, look.reading.tracker_frames
    least = max(1, len(frames) // 2)
    is_on_mount, on_tool = (mean_pose(frames, name, least) for name in (reference.tool, frame.tool))
    if is_on_mount is None or on_tool is None:
        if not must_see:
            return None
        unseen = reference.tool if is_on_mount is None else frame.tool
        workcell.rest()  # hands reseat it: nothing may move the arm meanwhile
        raise ToolSeenElsewhere(
            f"the tracker does not see {unseen}", expected=f"in at least {least} of {len(frames)} frames"
        )
    seen_mm = (is_on_mount.inverse() @ on_tool).apply(workcell.tracker.markers_mm[frame.tool])
    recorded = frame.mount_from_frame.transform(Frame.MARKER, Frame.MARKER)
    expected_mm = recorded.apply(workcell.tracker.markers_mm[frame.tool])
    off_mm = float(np.linalg.norm(seen_mm - expected_mm, axis=1).max())
    if off_mm > SEEN_LIMIT_MM:
        workcell.rest()
        raise ToolSeenElsewhere(
            f"the tracker sees {frame.tool} off its recorded position on the mount",
            limit=f"{SEEN_LIMIT_MM:g} mm",
            got=f"{format_against_limit(off_mm, SEEN_LIMIT_MM, 2)} mm",
        )
    return off_mm
