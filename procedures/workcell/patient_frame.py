"""Tracker readings relative to the patient's frame, the rigid body on the head clamp.

Frame by frame, everything that the tracker sees is expressed by where it is from the frame on the clamp. A
push against the tracker during the reading then moves nothing: the frame on the arm and the spheres stay
where they are against the clamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.journal.errors import GateFailed
from procedures.workcell.tracker_look import average_pose, mean_pose
from procedures.workcell.workcell import Workcell
from ronna_hw.devices.readings import ToolReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit

Array = NDArray[np.float64]

# Rms of the frame's markers about their places while nothing moves: 0.2 mm, the tracker's noise in one frame.
STILL_MM = 0.4
LEAST_STILL = 15  # frames at the end of a reading, 0.25 s, in which the tracker must have come to rest
# Of the frame on the arm against the clamp, before and after a push: over 600 mm, the rotation of the frame
# on the clamp has a noise of 0.3 mm in 15 frames.
ARM_STILL_MM = 1.0
OR_ANOTHER = "; if it is in view, its definition is that of another frame (ronna-rom check)"


def require_in_view(workcell: Workcell, frames: list[TrackerFrame]) -> None:
    """Raise PRO-007 unless most frames show the patient's frame. Without one in the theatre, do nothing."""
    name = workcell.patient_frame
    if name is not None and mean_pose(frames, name, len(frames) // 2) is None:
        raise GateFailed(
            f"the tracker does not see the frame on the head clamp, {name}",
            limit=f"in at least {len(frames) // 2} of {len(frames)} frames",
            got=f"{sum(frame.tool(name).validity is Validity.OK for frame in frames)}",
            action="Turn it to the tracker and clear the line of sight, then repeat the step"
            + OR_ANOTHER
            + ".",
        )


def hold_to_patient_frame(
    frames: list[TrackerFrame], name: str, markers_mm: ArrayLike, on_arm: str
) -> tuple[list[TrackerFrame], Transform]:
    """Return the frames as a tracker at its last place would see them, and the pose TRACKER <- PATIENT.

    Frames that do not show the patient's frame are left out. Raises PRO-007 if too few do, if the tracker has
    not come to rest, or if the frame on the arm has moved against the clamp meanwhile.
    """
    average_pose(frames, name)
    shown = [frame for frame in frames if frame.tool(name).validity is Validity.OK]
    poses = [frame.tool(name).transform(Frame.TRACKER, Frame.PATIENT) for frame in shown]
    places = np.array([pose.apply(markers_mm) for pose in poses])
    still = _count_still(places)
    pose = average_pose_of(shown[-still:], name)
    held = [_seen_after(pose @ one.inverse(), frame) for one, frame in zip(poses, shown, strict=True)]
    if still < len(held):
        _require_arm_still(held[:-still], held[-still:], on_arm)
    return held, pose


def average_pose_of(frames: list[TrackerFrame], name: str) -> Transform:
    """Return the mean pose TRACKER <- PATIENT over frames that all show the frame."""
    seen = mean_pose(frames, name, len(frames))
    assert seen is not None  # each frame shows it
    return as_patient(seen)


def as_patient(pose: Transform) -> Transform:
    """Return a tool's pose with its frame named as the patient's."""
    return Transform(pose.target, Frame.PATIENT, pose.rigid)


def posed_markers(frame: TrackerFrame, name: str, markers_mm: ArrayLike) -> Sequence[Sequence[float]]:
    """Return the markers (n, 3) of the patient's frame by its pose in a tracker frame; none if not seen."""
    reading = frame.tool(name)
    if reading.validity is not Validity.OK:
        return ()
    places: list[list[float]] = reading.transform(Frame.TRACKER, Frame.PATIENT).apply(markers_mm).tolist()
    return places


def _count_still(places_mm: Array) -> int:
    """Return how many of the last frames show the markers (k, n, 3) at rest."""
    count = len(places_mm)
    while True:
        last = places_mm[-count:]
        spread_mm = float(np.sqrt(((last - last.mean(axis=0)) ** 2).sum(axis=2).mean()))
        if spread_mm <= STILL_MM:
            return count
        if count <= LEAST_STILL:
            raise GateFailed(
                "the tracker, or the frame on the head clamp, moved until the end of the reading",
                limit=f"{STILL_MM:g} mm rms over {count} frames",
                got=f"{format_against_limit(spread_mm, STILL_MM, 2)} mm",
                action="Lock the tracker's stand and the clamp, let nobody touch them, then repeat the step.",
            )
        count = max(count // 2, LEAST_STILL)


def _require_arm_still(before: list[TrackerFrame], after: list[TrackerFrame], on_arm: str) -> None:
    seen = [mean_pose(frames, on_arm, 1) for frames in (before, after)]
    if seen[0] is None or seen[1] is None:
        return
    moved_mm = float(np.linalg.norm(seen[1].translation_mm - seen[0].translation_mm))
    if moved_mm > ARM_STILL_MM:
        raise GateFailed(
            "the head clamp and the arm moved against each other while the tracker was measuring",
            limit=f"{ARM_STILL_MM:g} mm",
            got=f"{format_against_limit(moved_mm, ARM_STILL_MM, 2)} mm",
            action="Lock table, clamp and cart, then repeat the step.",
        )


def _seen_after(move: Transform, frame: TrackerFrame) -> TrackerFrame:
    """Return a frame with everything in view moved by TRACKER <- TRACKER."""
    tools = tuple(_moved_tool(move, one) for one in frame.tools)
    if not frame.strays:
        return replace(frame, tools=tools)
    places = move.apply([one.position_mm for one in frame.strays]).tolist()
    strays = tuple(
        replace(one, position_mm=(x, y, z)) for one, (x, y, z) in zip(frame.strays, places, strict=True)
    )
    return replace(frame, tools=tools, strays=strays)


def _moved_tool(move: Transform, reading: ToolReading) -> ToolReading:
    if reading.validity is not Validity.OK:
        return reading
    pose = move @ reading.transform(Frame.TRACKER, Frame.MARKER)
    w, qx, qy, qz = pose.quaternion_wxyz.tolist()
    x, y, z = pose.translation_mm.tolist()
    return replace(reading, rotation=(w, qx, qy, qz), position_mm=(x, y, z))
