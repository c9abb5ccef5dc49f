"""Tracker readings while the arm is at rest: a number of distinct measurements, and their mean."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from procedures.results.errors import GateFailed
from procedures.workcell.device_views import TrackerView
from procedures.workcell.frame_as_tool import with_its_spheres
from procedures.workcell.mounted_tool import MountedTool
from procedures.workcell.workcell import Workcell
from ronna_hw.clock import Clock
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector, TrackerFrame, Validity
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.frames import Frame, Transform

FRAMES = 60  # one second of a 60 Hz tracker
FRAME_S = 1 / 60
LEAST_FRAMES_WITH_TOOL = 30
READING_LIMIT_S = 10.0  # theatre time; a 20 Hz illuminator needs three
MOST_LOST_READINGS = 20  # a quarter of all: beyond it the line needs a person


def robot_from_marker(workcell: Workcell, joints_rad: JointVector) -> Transform:
    """Nominal pose ROBOT <- MARKER of the reference frame on the arm."""
    frame = workcell.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    flange = workcell.flange_pose(joints_rad)
    return flange @ workcell.flange_from(MountedTool.STEREO_HEAD) @ frame


def frames_at_rest(
    tracker: TrackerView,
    clock: Clock,
    progress: Callable[[float], None] = lambda _share: None,
    count: int = FRAMES,
) -> tuple[list[TrackerFrame], int]:
    """As `fresh_frames`, with the tracking begun for them and ended after them."""
    tracker.activate()
    try:
        return fresh_frames(tracker, clock, progress, count)
    finally:
        if tracker.state is not Lifecycle.FAULT:  # a fault has ended the tracking, and is what must be told
            tracker.deactivate()


def fresh_frames(
    tracker: TrackerView, clock: Clock, progress: Callable[[float], None], count: int = FRAMES
) -> tuple[list[TrackerFrame], int]:
    """So many measurements, each another one, and how many readings were lost on the way.

    A lost or garbled reply costs one reading: the driver has recovered by the next. Raises PRO-007 if the
    tracker returns too few in time, and the driver's own error when the line is too bad.
    """
    limit_s = clock.now_s() + READING_LIMIT_S
    frames: list[TrackerFrame] = []
    lost = 0
    while len(frames) < count:
        try:
            frame = tracker.read_frame()
        except (LinkTimeout, ProtocolError):
            lost += 1
            if lost > MOST_LOST_READINGS or tracker.state is not Lifecycle.ACTIVE:
                raise
            limit_s += READING_LIMIT_S / count
            continue
        if frame.validity is not Validity.STALE:
            frames.append(with_its_spheres(tracker, frame))
            progress(len(frames) / count)
        elif clock.now_s() > limit_s:
            raise GateFailed(
                "the tracker returns no new measurements", expected=f"{count}", got=f"{len(frames)}"
            )
        else:
            clock.sleep(FRAME_S / 2)
    return frames, lost


def average_pose(frames: list[TrackerFrame], tool: str) -> Transform:
    """Mean pose TRACKER <- MARKER of the reference frame over the frames that show it. Raises PRO-007."""
    poses = poses_of(frames, tool)
    if len(poses) < LEAST_FRAMES_WITH_TOOL:
        why, action = _why_unseen(frames, tool)
        raise GateFailed(
            f"the reference frame {tool} is in {len(poses)} of {len(frames)} frames{why}",
            limit=f"at least {LEAST_FRAMES_WITH_TOOL}",
            action=f"{action}, then repeat the step.",
        )
    return mean_of(poses)


def _why_unseen(frames: list[TrackerFrame], tool: str) -> tuple[str, str]:
    """What most frames without the tool have in common, and what to do about it."""
    readings = [frame.tool(tool) for frame in frames]
    outside = sum(reading.validity is Validity.OUT_OF_VOLUME for reading in readings)
    disturbed = sum(
        Validity.PARTIAL in (frame.validity, reading.validity)
        for frame, reading in zip(frames, readings, strict=True)
    )
    if outside > disturbed:
        return f", outside the measuring volume in {outside}", "Move the tracker so that the tool is inside"
    if disturbed:
        return f", disturbed by infrared light in {disturbed}", "Shade the tracker from sun and lamps"
    return "", "Clear the line of sight between tracker and tool"


def mean_pose(frames: list[TrackerFrame], tool: str, least: int) -> Transform | None:
    """Mean pose TRACKER <- MARKER of the reference frame; None when fewer than `least` frames show it."""
    poses = poses_of(frames, tool)
    return mean_of(poses) if len(poses) >= least else None


def poses_of(frames: list[TrackerFrame], tool: str) -> list[Transform]:
    """Poses TRACKER <- MARKER of the reference frame in the frames that show it."""
    readings = [frame.tool(tool) for frame in frames]
    return [
        reading.transform(Frame.TRACKER, Frame.MARKER)
        for reading in readings
        if reading.validity is Validity.OK
    ]


def mean_of(poses: list[Transform]) -> Transform:
    """Their mean; at least one."""
    from scipy.spatial.transform import RigidTransform, Rotation

    rotation = Rotation.from_matrix(np.array([pose.rotation_matrix for pose in poses])).mean()
    translation = np.mean([pose.translation_mm for pose in poses], axis=0)
    return Transform(Frame.TRACKER, Frame.MARKER, RigidTransform.from_components(translation, rotation))
