"""Poses for the calibration of the reference frame: rotated about the frame itself, in all directions.

The frame stays nearly in place while it turns. The tracker's smooth error over its volume is then the same in
all poses, and affects the tracker's pose rather than the frame's on the flange.
"""

from __future__ import annotations

import numpy as np

from procedures.calibration.pose_set import PlannedLook, in_short_order, turned_about
from ronna_hw.frames import Transform

TILT_RAD = float(np.radians(35.0))  # with more, the arm or the frame's own edge hides markers
TURN_RAD = float(np.radians(70.0))


def frame_poses(reference: Transform, tool_from_marker: Transform, count: int) -> tuple[PlannedLook, ...]:
    """Poses ROBOT <- TOOL around a reference pose, each nearest in orientation to the previous one."""
    in_tool = tool_from_marker.translation_mm
    place = reference.apply(in_tool)
    looks = turned_about(
        reference.rigid.rotation, place, count, tilt_rad=TILT_RAD, turn_rad=TURN_RAD, offset_mm=in_tool
    )
    return tuple(in_short_order(looks))
