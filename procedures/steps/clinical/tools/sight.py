"""Gross check of a mounted tool: the tracker sees the frame on it where the tool's record says, to 1 mm.

The frame on the tool is compared with frame M on the mount, in the same readings. So neither the arm, nor the
place of the tracker, nor any calibration comes in. It is done before the tool is moved anywhere: a longer one
would run into the gauge.
"""

from __future__ import annotations

import numpy as np

from procedures.engine.context import StepContext
from procedures.steps.errors import ToolSeenElsewhere
from procedures.workcell.tracker_look import frames_at_rest, mean_pose
from ronna_hw.frames import Frame
from ronna_hw.text import beyond
from ronna_hw.tool_record import ToolFrame

SEEN_LIMIT_MM = (
    1.0  # of any sphere on the tool: a gross check, above the tracker's error; the gauge sees the rest
)
FRAMES, LEAST_FRAMES = 30, 15  # half a second, and how many of them must show both


def require_seen_in_place(context: StepContext, frame: ToolFrame, *, must_see: bool = True) -> float | None:
    """Largest distance of a sphere of the tool from its recorded position, mm. Raises TOOL-006.

    None where a frame is hidden that need not be seen.
    """
    workcell = context.workcell
    reference = workcell.calibrations.tracker_frame
    workcell.rest()  # the tracker measures while the arm's stream is off
    frames, _ = frames_at_rest(workcell.tracker, context.setting.clock, count=FRAMES)
    on_mount = mean_pose(frames, reference.tool, LEAST_FRAMES)
    on_tool = mean_pose(frames, frame.tool, LEAST_FRAMES)
    if on_mount is None or on_tool is None:
        if not must_see:
            return None
        unseen = reference.tool if on_mount is None else frame.tool
        raise ToolSeenElsewhere(
            f"the tracker does not see {unseen}", expected=f"in at least {LEAST_FRAMES} of {FRAMES} frames"
        )
    seen_mm = (on_mount.inverse() @ on_tool).apply(workcell.tracker.markers_mm[frame.tool])
    recorded = frame.mount_from_frame.transform(Frame.MARKER, Frame.MARKER)
    expected_mm = recorded.apply(workcell.tracker.markers_mm[frame.tool])
    off_mm = float(np.linalg.norm(seen_mm - expected_mm, axis=1).max())
    if off_mm > SEEN_LIMIT_MM:
        raise ToolSeenElsewhere(
            f"the tracker sees {frame.tool} off its recorded position on the mount",
            limit=f"{SEEN_LIMIT_MM:g} mm",
            got=f"{beyond(off_mm, SEEN_LIMIT_MM, 2)} mm",
        )
    return off_mm
