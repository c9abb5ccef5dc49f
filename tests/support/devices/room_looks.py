"""Readings of the room as a watch takes them, from points that a tracker has averaged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from procedures.guards.room_reading import RoomReading
from procedures.room.sighting import MARKER_NOISE_MM, Rest, SeenFrame, Tracked, expect_frame
from ronna_hw.arrays import Array
from ronna_hw.devices.strays import StrayGroup
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector


def room_reading_of(
    flange: Transform,
    joints_rad: JointVector,
    spheres_mm: ArrayLike,
    count: int,
    *,
    sides: Sequence[int] | None = None,
    arm: SeenFrame | None = None,
    clamp: SeenFrame | None = None,
    frame_mm: Array | None = None,
    markers_mm: ArrayLike | None = None,
) -> RoomReading:
    """A reading of `count` frames: strays (m, 3) and frames, tracker frame, the arm at these joints."""
    scatter = np.diag(MARKER_NOISE_MM**2)
    groups = tuple(
        StrayGroup(np.asarray(place, dtype=float), 0.0, scatter, count, 0)
        for place in np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
    )
    frames = {Tracked.ARM: arm, Tracked.CLAMP: clamp}
    on_arm = np.empty((0, 3)) if arm is None else arm.markers_mm
    return RoomReading(
        robot_from_flange=flange,
        rests={Tracked.ARM: Rest(joints_rad, None if sides is None else tuple(sides))},
        frame_mm=frame_mm,
        groups=groups,
        markers_mm=on_arm if markers_mm is None else np.asarray(markers_mm, dtype=float),
        frames={name: seen for name, seen in frames.items() if seen is not None},
        count=count,
        settled_home=sides is not None,
    )


def seen_frame(pose: ArrayLike, markers_mm: ArrayLike, count: int) -> SeenFrame:
    """A frame as seen at a pose (4, 4), tracker frame, in the mean of `count` frames."""
    matrix = np.asarray(pose, dtype=float)
    return expect_frame(matrix[:3, 3], matrix[:3, :3], markers_mm, count)
