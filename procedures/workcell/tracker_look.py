"""Tracker readings while the arm is at rest: a number of distinct measurements, and their mean."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from procedures.journal.errors import GateFailed
from procedures.workcell.device_views import TrackerView
from procedures.workcell.frame_as_tool import with_its_spheres
from procedures.workcell.mounted_tool import MountedTool
from procedures.workcell.workcell import Workcell
from ronna_hw.clock import Clock
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector, Quaternion, TrackerFrame, Validity, Vector3
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.frames import Frame, FrameMismatch, Transform

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
    shown = _shown(frames, tool)
    if len(shown) < LEAST_FRAMES_WITH_TOOL:
        why, action = _why_unseen(frames, tool)
        raise GateFailed(
            f"the reference frame {tool} is in {len(shown)} of {len(frames)} frames{why}",
            limit=f"at least {LEAST_FRAMES_WITH_TOOL}",
            action=f"{action}, then repeat the step.",
        )
    return _mean_of(shown)


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
    shown = _shown(frames, tool)
    return _mean_of(shown) if len(shown) >= least else None


def _shown(frames: list[TrackerFrame], tool: str) -> list[tuple[Quaternion, Vector3]]:
    """Rotations and places of the reference frame in the frames that show it."""
    readings = (frame.tool(tool) for frame in frames)
    return [
        (one.rotation, one.position_mm)
        for one in readings
        if one.validity is Validity.OK and one.rotation is not None and one.position_mm is not None
    ]


def _mean_of(shown: list[tuple[Quaternion, Vector3]]) -> Transform:
    """Mean of their poses TRACKER <- MARKER; at least one."""
    from scipy.spatial.transform import RigidTransform, Rotation

    quaternions, places_mm = (np.array(values, dtype=float) for values in zip(*shown, strict=True))
    rotations = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    if not (np.isfinite(rotations).all() and np.isfinite(places_mm).all()):
        raise FrameMismatch("expected finite poses from the tracker")
    mean = RigidTransform.from_components(np.mean(places_mm, axis=0), Rotation.from_matrix(rotations).mean())
    return Transform(Frame.TRACKER, Frame.MARKER, mean)
