"""Global localization: the tracker reads the reference frame on the tool and all stray spheres.

The arm rests and RSI is off. Exactly FRAMES measurements are taken and averaged. A tracker that is asked
faster than it measures gives the same one again; those do not count.
"""

from __future__ import annotations

import numpy as np

from procedures.engine.errors import GateFailed
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.steps.arm_frames import stereo_tool_in_flange, tool_pose
from procedures.steps.payloads import points_payload, pose_payload
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.devices.strays import average_strays
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.frames import Frame, Transform

FRAMES = 60  # one second of a 60 Hz tracker
FRAME_S = 1 / 60
READING_LIMIT_S = 10.0  # theatre time; a 20 Hz illuminator needs three
LEAST_FRAMES_WITH_TOOL = 30
MOST_LOST_READINGS = 20  # a quarter of all: beyond it the line needs a person
SPREAD_LIMIT_MM = 1.0  # rms of one sphere over the frames; more means that something moved


def run(context: StepContext) -> Outcome:
    """Measure all strays in the robot frame by way of the reference frame M."""
    tracker = context.devices.tracker
    tracker.activate()
    try:
        frames, lost = _fresh_frames(context)
    finally:
        if tracker.state is not Lifecycle.FAULT:  # a fault has ended the tracking, and is what must be told
            tracker.deactivate()
    calibration = context.calibrations.tracker_frame
    tracker_from_marker = _average_pose(frames, calibration.tool)
    strays = average_strays(frames)
    groups = strays.groups
    spread = max((float(group.spread_mm) for group in groups), default=0.0)
    if spread > SPREAD_LIMIT_MM:
        raise GateFailed(
            "a sphere moved while the tracker looked", limit=f"{SPREAD_LIMIT_MM} mm", got=f"{spread:.2f} mm"
        )
    joints = context.devices.arm.read_state().joints_rad
    robot_from_tool = tool_pose(context, joints, stereo_tool_in_flange(context))
    tool_from_marker = calibration.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    robot_from_tracker = robot_from_tool @ tool_from_marker @ tracker_from_marker.inverse()
    points = np.array([group.mean_mm for group in groups]).reshape(-1, 3)
    return Outcome(
        payload={
            "frames": FRAMES,
            "points_robot_mm": points_payload(robot_from_tracker.apply(points) if len(points) else points),
            "points_tracker_mm": points_payload(points),
            "spread_mm": [float(group.spread_mm) for group in groups],
            "counts": [int(group.count) for group in groups],
            "outliers": [int(group.outliers) for group in groups],
            "rejected_strays": len(strays.rejected),
            "lost_readings": lost,
            "robot_from_tracker": pose_payload(robot_from_tracker),
            "joints_rad": list(joints),
        },
        parents=(context.case.get("set_up"),),
        summary=f"{len(groups)} stray spheres in {FRAMES} frames, largest spread {spread:.2f} mm"
        + (f", {lost} readings lost on the line" if lost else ""),
    )


def _fresh_frames(context: StepContext) -> tuple[list[TrackerFrame], int]:
    """FRAMES measurements, each another one, and how many readings were lost on the way.

    A lost or garbled reply costs one reading: the driver is on its feet again with the next. Raises PRO-007
    when the tracker gives too few in time, and the driver's own error when the line is too bad.
    """
    clock, tracker = context.clock, context.devices.tracker
    limit_s = clock.now_s() + READING_LIMIT_S
    frames: list[TrackerFrame] = []
    lost = 0
    while len(frames) < FRAMES:
        try:
            frame = tracker.read_frame()
        except (LinkTimeout, ProtocolError):
            lost += 1
            if lost > MOST_LOST_READINGS or tracker.state is not Lifecycle.ACTIVE:
                raise
            limit_s += READING_LIMIT_S / FRAMES
            continue
        if frame.validity is not Validity.STALE:
            frames.append(frame)
            context.progress(len(frames) / FRAMES, "reading the tracker")
        elif clock.now_s() > limit_s:
            raise GateFailed(
                "the tracker gives no new measurements", expected=f"{FRAMES}", got=f"{len(frames)}"
            )
        else:
            clock.sleep(FRAME_S / 2)
    return frames, lost


def _average_pose(frames: list[TrackerFrame], tool: str) -> Transform:
    """Mean pose TRACKER <- MARKER of the reference frame over the frames that show it."""
    from scipy.spatial.transform import RigidTransform, Rotation

    readings = [frame.tool(tool) for frame in frames]
    poses = [
        reading.transform(Frame.TRACKER, Frame.MARKER)
        for reading in readings
        if reading.validity is Validity.OK
    ]
    if len(poses) < LEAST_FRAMES_WITH_TOOL:
        why, action = _why_unseen(frames, tool)
        raise GateFailed(
            f"the reference frame {tool} is in {len(poses)} of {len(frames)} frames{why}",
            limit=f"at least {LEAST_FRAMES_WITH_TOOL}",
            action=f"{action}, then repeat the step.",
        )
    rotation = Rotation.from_matrix(np.array([pose.rotation_matrix for pose in poses])).mean()
    translation = np.mean([pose.translation_mm for pose in poses], axis=0)
    return Transform(Frame.TRACKER, Frame.MARKER, RigidTransform.from_components(translation, rotation))


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


STEP = StepSpec("global_localization", "Localize all spheres with the tracker", needs=("set_up",), run=run)
