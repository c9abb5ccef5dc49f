"""Tracker readings with the arm at rest: distinct frames and mean poses.

A tracker with the definition of the x-shaped frame loaded reports the frame on the head as one pose instead
of as strays. The markers of that pose are added to the strays, for the watches of the spheres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from procedures.journal.errors import GateFailed
from procedures.planning.errors import SPHERES_NOT_TRACKED
from procedures.planning.plan_model import FiducialKind
from procedures.strategies.strategy import Sides
from procedures.workcell.tools import MountedTool
from procedures.workcell.workcell import Workcell
from ronna_hw.arrays import Array
from ronna_hw.clock import Clock
from ronna_hw.devices import OpticalTracker
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.devices.readings import StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.devices.sensors import reports_strays
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.vectors import JointVector, Quaternion, Vector3
from ronna_hw.x_frame import SPHERE_CENTRES_MM

ALIKE_MM = 0.05  # between a loaded definition and the frame: definitions have two decimals
FRAMES = 60  # one second of a 60 Hz tracker
FRAME_S = 1 / 60  # period of the tracker's frame counter
LEAST_FRAMES_WITH_TOOL = 30
READING_LIMIT_S = 10.0  # theatre time; a 20 Hz illuminator needs three
MOST_LOST_READINGS = 20  # a quarter of all: beyond it the line needs a person


def robot_from_marker(workcell: Workcell, joints_rad: JointVector, arrived: Sides = None) -> Transform:
    """Return the reference frame's pose ROBOT <- MARKER at these joints; see `Sides`."""
    return workcell.master.flange_pose(joints_rad, arrived) @ flange_from_marker(workcell)


def flange_from_marker(workcell: Workcell) -> Transform:
    """Return the reference frame's place on the arm, FLANGE <- MARKER."""
    frame = workcell.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    return workcell.master.flange_from(MountedTool.STEREO_HEAD) @ frame


def read_frames_at_rest(
    workcell: Workcell, progress: Callable[[float], None] = lambda _share: None, count: int = FRAMES
) -> tuple[list[TrackerFrame], int]:
    """Start tracking, read `count` distinct frames and stop tracking; see `read_fresh_frames`."""
    tracker = workcell.tracker
    tracker.activate()
    try:
        return read_fresh_frames(tracker, workcell.clock, progress, count)
    finally:
        if tracker.state is not Lifecycle.FAULT:  # a fault ended the tracking, and must be reported
            tracker.deactivate()


def read_fresh_frames(
    tracker: OpticalTracker, clock: Clock, progress: Callable[[float], None], count: int = FRAMES
) -> tuple[list[TrackerFrame], int]:
    """Read distinct frames; also return the number of lost readings.

    A lost or garbled reply costs one reading: the driver has recovered by the next. Raises PRO-007 if the
    tracker returns too few in time, and the driver's error if too many are lost.
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
            frames.append(add_frame_spheres(tracker, frame))
            progress(len(frames) / count)
        elif clock.now_s() > limit_s:
            raise GateFailed(
                "the tracker returns no new measurements", expected=f"{count}", got=f"{len(frames)}"
            )
        else:
            clock.sleep(FRAME_S / 2)
    return frames, lost


def average_pose(frames: list[TrackerFrame], tool: str) -> Transform:
    """Return a tool's mean pose TRACKER <- MARKER. Raises PRO-007 if too few frames show the tool."""
    seen_poses = list_poses(frames, tool)
    if len(seen_poses) < LEAST_FRAMES_WITH_TOOL:
        why, action = _explain_missing_frames(frames, tool)
        raise GateFailed(
            f"the reference frame {tool} is in {len(seen_poses)} of {len(frames)} frames{why}",
            limit=f"at least {LEAST_FRAMES_WITH_TOOL}",
            action=f"{action}, then repeat the step.",
        )
    return _average_poses(seen_poses)


def mean_pose(frames: Sequence[TrackerFrame], tool: str, least: int) -> Transform | None:
    """Return a tool's mean pose TRACKER <- MARKER, or None if seen in fewer than `least` frames."""
    seen_poses = list_poses(frames, tool)
    return _average_poses(seen_poses) if len(seen_poses) >= least else None


def _explain_missing_frames(frames: list[TrackerFrame], tool: str) -> tuple[str, str]:
    """Return the main reason why frames lack the tool, and the action to take."""
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


def list_poses(frames: Sequence[TrackerFrame], tool: str) -> list[tuple[Quaternion, Vector3]]:
    """List a tool's rotations and positions from the frames that show it."""
    return [
        (one.rotation, one.position_mm)
        for one in _list_readings(frames, tool)
        if one.rotation is not None and one.position_mm is not None
    ]


def marker_shares(frames: Sequence[TrackerFrame], tool: str, markers: int) -> Array:
    """Return the share (m,) of a tool's poses that each of its markers was used for; all if none says so."""
    used = [one.markers_used or (True,) * markers for one in _list_readings(frames, tool)]
    return np.asarray(np.mean(used, axis=0), dtype=float)


def _list_readings(frames: Sequence[TrackerFrame], tool: str) -> list[ToolReading]:
    readings = (frame.tool(tool) for frame in frames)
    return [one for one in readings if one.validity is Validity.OK and one.rotation is not None]


def _average_poses(seen_poses: list[tuple[Quaternion, Vector3]]) -> Transform:
    """Return the mean pose TRACKER <- MARKER of one or more poses."""
    from scipy.spatial.transform import RigidTransform, Rotation

    quaternions, places_mm = (np.array(values, dtype=float) for values in zip(*seen_poses, strict=True))
    rotations = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    if not (np.isfinite(rotations).all() and np.isfinite(places_mm).all()):
        raise FRAME_MISMATCH("expected finite poses from the tracker")
    mean = RigidTransform.from_components(np.mean(places_mm, axis=0), Rotation.from_matrix(rotations).mean())
    return Transform(Frame.TRACKER, Frame.MARKER, mean)


def add_frame_spheres(tracker: OpticalTracker, frame: TrackerFrame) -> TrackerFrame:
    """Add the spheres of the frame on the head to the strays, provided the frame is tracked as a tool."""
    name = find_frame_name(tracker.markers_mm)
    if name is None or (reading := frame.tool(name)).validity is not Validity.OK:
        return frame
    places = reading.transform(Frame.TRACKER, Frame.MARKER).apply(tracker.markers_mm[name]).tolist()
    more = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places)
    return replace(frame, strays=(*frame.strays, *more))


def require_tracked_spheres(tracker: Device, kind: FiducialKind) -> None:
    """Raise PLAN-034 if the tracker reports no strays and does not track the plan's spheres as a tool.

    A head without spheres needs none: pointer and frame on the clamp are tools.
    """
    is_enough = kind is FiducialKind.SURFACE or reports_strays(tracker)
    if is_enough or not isinstance(tracker, OpticalTracker):
        return
    if kind is not FiducialKind.XFRAME:
        raise SPHERES_NOT_TRACKED(
            f"the tracker reports tools alone, and the plan's spheres are of kind {kind}",
            expected=f'fiducials = "{FiducialKind.XFRAME}"',
        )
    if find_frame_name(tracker.markers_mm) is None:
        raise SPHERES_NOT_TRACKED(
            "the tracker reports tools alone, and none of them is the x-shaped frame",
            expected="a tool with the markers "
            + ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in SPHERE_CENTRES_MM),
            got=", ".join(tracker.tools),
        )


def markers_in_frame(tracker: OpticalTracker, frame: TrackerFrame) -> Array:
    """Return the markers (n, 3) of the tools seen in a frame, except those of the frame on the head."""
    on_head = find_frame_name(tracker.markers_mm)
    seen = [name for name in tracker.markers_mm if name != on_head]
    poses = [frame.tool(name) for name in seen]
    places = [
        reading.transform(Frame.TRACKER, Frame.MARKER).apply(tracker.markers_mm[name])
        for name, reading in zip(seen, poses, strict=True)
        if reading.validity is Validity.OK
    ]
    return np.concatenate(places) if places else np.empty((0, 3))


def find_frame_name(markers_mm: Mapping[str, Sequence[Sequence[float]]]) -> str | None:
    """Return the name of the tool whose markers match the x-shaped frame in order, or None."""
    for name, markers in markers_mm.items():
        if len(markers) == len(SPHERE_CENTRES_MM) and all(map(_are_alike, markers, SPHERE_CENTRES_MM)):
            return name
    return None


def _are_alike(marker: Sequence[float], centre: Sequence[float]) -> bool:
    """Return whether two points agree in each coordinate. Avoids NumPy, as it runs for every frame."""
    return all(abs(one - other) <= ALIKE_MM for one, other in zip(marker, centre, strict=True))
