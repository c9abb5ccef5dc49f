"""One look of the tracker at the room: the frame on the arm and the spheres, while the arm rests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from procedures.engine.context import CaseMemory
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_watch import RoomLook, RoomReading, RoomWatch
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import frames_at_rest, mean_pose, robot_from_marker
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.strays import average_strays
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform

FRAMES = 12  # 0.2 s: the noise of a frame's place is then 0.02 mm, of a sphere 0.05 mm
LEAST_SHARE = 0.5  # of the frames that must show what is averaged


def read_room(
    workcell: Workcell, clock: Clock, robot_from_tracker: Transform, count: int = FRAMES
) -> RoomReading:
    """Read so many frames of the tracker while the arm rests. Raises what the tracker raises."""
    frames, _ = frames_at_rest(workcell.tracker, clock, count=count)
    return room_reading(workcell, frames, robot_from_tracker)


def check_now(
    room: RoomWatch,
    workcell: Workcell,
    clock: Clock,
    memory: CaseMemory,
    void: Callable[[RonnaError], None],
    count: int = FRAMES,
) -> RoomLook:
    """Look now and compare; raises as `RoomWatch.check`. A movement ends the watch, and `void`s first."""
    look = room.compare(read_room(workcell, clock, room.robot_from_tracker, count), clock.now_s())
    if isinstance(look.moved, BaseShifted | PatientMoved):
        void(look.moved)  # first: as long as that is not written, the watch goes on
        memory.drop(RoomWatch)  # the way out is not to be stopped by the same
    if look.moved is not None:
        raise look.moved
    return look


def room_reading(
    workcell: Workcell, frames: list[TrackerFrame], robot_from_tracker: Transform
) -> RoomReading:
    """What these frames show, with the arm in its present pose."""
    groups = average_strays(frames).groups
    spheres = np.array([group.mean_mm for group in groups]).reshape(-1, 3)
    least, on_arm = round(LEAST_SHARE * len(frames)), workcell.calibrations.tracker_frame.tool
    seen = mean_pose(frames, on_arm, least)
    joints = workcell.joints_rad()
    by_arm = robot_from_marker(workcell, joints)
    frame_mm = None
    if seen is not None:
        frame_mm = (robot_from_tracker @ seen).translation_mm - by_arm.translation_mm
    frame = robot_from_tracker.inverse() @ by_arm if seen is None else seen
    markers = [frame.apply(workcell.tracker.markers_mm[on_arm])]
    for name, places_mm in workcell.tracker.markers_mm.items():  # the guide's make ghosts as well
        other = None if name == on_arm else mean_pose(frames, name, least)
        if other is not None:
            markers.append(other.apply(places_mm))
    return RoomReading(
        workcell.flange_pose(joints),
        frame_mm,
        spheres,
        np.vstack(markers),
        len(frames),
        workcell.settled_home,
    )
