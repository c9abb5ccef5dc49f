"""Tracker readings relative to the patient's frame, the rigid body on the head clamp.

A reading is divided where the tracker moved against the clamp. Only what it shows since then counts, and the
caller repeats a reading that was divided: carried over by the rotation of the frame on the clamp, what was
seen before a push is off by some tenths of a millimetre, and later looks are held against hundredths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from procedures.journal.errors import GateFailed
from procedures.workcell.tracker_look import average_pose, mean_pose
from procedures.workcell.workcell import Workcell
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import ToolReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit

# Rms of the frame's markers from their mean place within a spell: by the tracker's noise 0.2 mm in one frame,
# twice that in sunlight.
# Safety against a tracker or clamp that moves during a reading (U).
STILL_MM = 1.0

LEAST_STILL = 15  # frames of a spell, 0.25 s; what is shorter is a movement
# Of the frame on the arm against the clamp, from spell to spell: over 600 mm, the rotation of the frame on
# the clamp has a noise of 0.3 mm in 15 frames.
# Safety against a tracker or clamp that moves during a reading (U).
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


class HeldReading(NamedTuple):
    """Frames since the tracker rests, the pose TRACKER <- PATIENT, and whether it moved meanwhile."""

    frames: list[TrackerFrame]
    patient: Transform
    pushed: bool


def hold_to_patient_frame(
    frames: list[TrackerFrame], name: str, markers_mm: ArrayLike, on_arm: str
) -> HeldReading:
    """Return what a reading shows since the tracker came to rest against the clamp.

    Frames that do not show the patient's frame are left out. Raises PRO-007 if too few do, or if the frame on
    the arm has moved against the clamp meanwhile.
    """
    average_pose(frames, name)
    shown = [frame for frame in frames if frame.tool(name).validity is Validity.OK]
    spells = _divide(shown, name, markers_mm)
    pose = average_pose_of(spells[-1], name)
    if len(spells[-1]) < LEAST_STILL:  # it moves until the end
        return HeldReading(spells[-1], pose, True)
    for spell in spells[:-1]:
        if len(spell) >= LEAST_STILL:
            move = pose @ average_pose_of(spell, name).inverse()
            _require_arm_still(move, spell, spells[-1], on_arm)
    return HeldReading(spells[-1], pose, len(spells) > 1)


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


def _divide(frames: list[TrackerFrame], name: str, markers_mm: ArrayLike) -> list[list[TrackerFrame]]:
    """Divide frames that show the patient's frame into spells in which its markers (n, 3) rest.

    Single frames that show it elsewhere, between others that do not, are left out.
    """
    spells: list[list[TrackerFrame]] = []
    totals: list[Array] = []  # of the markers' places
    for frame in frames:
        places = np.asarray(posed_markers(frame, name, markers_mm))
        if len(spells) > 1 and len(spells[-1]) < LEAST_STILL and _rests(places, totals[-2], spells[-2]):
            spells.pop()
            totals.pop()
        if spells and _rests(places, totals[-1], spells[-1]):
            spells[-1].append(frame)
            totals[-1] = totals[-1] + places
        else:
            spells.append([frame])
            totals.append(places)
    return spells


def _rests(places_mm: Array, total_mm: Array, spell: list[TrackerFrame]) -> bool:
    away_mm = places_mm - total_mm / len(spell)
    return float(np.sqrt((away_mm**2).sum(axis=1).mean())) <= STILL_MM


def _require_arm_still(
    move: Transform, before: list[TrackerFrame], after: list[TrackerFrame], on_arm: str
) -> None:
    """Raise PRO-007 if the frame on the arm is elsewhere than `move`, that of the clamp, brings it."""
    was, now = (mean_pose(frames, on_arm, 1) for frames in (before, after))
    if was is None or now is None:
        return
    moved_mm = float(np.linalg.norm(now.translation_mm - (move @ was).translation_mm))
    if moved_mm > ARM_STILL_MM:
        raise GateFailed(
            "the head clamp and the arm moved against each other while the tracker was measuring",
            limit=f"{ARM_STILL_MM:g} mm",
            got=f"{format_against_limit(moved_mm, ARM_STILL_MM, 2)} mm",
            action="Lock table, clamp and cart, then repeat the step.",
        )


def seen_after(move: Transform, frame: TrackerFrame) -> TrackerFrame:
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
