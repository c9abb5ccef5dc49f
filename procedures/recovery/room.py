"""Patient and robot base after a restart: the tracker measures both again and holds them against the record.

The spheres on the head are compared where the tracker sees them, the robot's base by the reference frame on
the arm. The frame tells of the base only where the arm stands as it stood when both were recorded: elsewhere
its own errors are as large as what is looked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.engine.engine import Engine
from procedures.engine.errors import GateFailed
from procedures.recovery.comparison import Comparison
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization, average_pose, fresh_frames
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

LARGEST_SHIFT_MM = 0.5  # rms of the spheres on the head; see the reference's G.2, "reference moved"
LARGEST_BASE_SHIFT_MM = 1.7  # of the frame on the arm
NEAR_MM = 15.0  # a sphere farther from its place is another one; spheres are 11.5 mm wide and well apart
FEWEST_SPHERES = 3


@dataclass(frozen=True)
class Sighting:
    """Spheres (n, 3) in the tracker's frame, and the frame on the arm where it was seen often enough."""

    spheres_mm: Array
    tracker_from_marker: Transform | None


def compare_room(engine: Engine, comparison: Comparison) -> bool:
    """Compare both; False when the tracker sees too little of the head from here. Raises what it raises."""
    stored = engine.case.find(GlobalLocalization, None)
    if stored is None:
        comparison.note("patient and robot base: not recorded yet, nothing to compare")
        return True
    recorded, seen = stored.result, _look(engine)
    shift_mm = shift_of_spheres_mm(_spheres_of(engine, recorded), seen.spheres_mm)
    if shift_mm is None:
        return False
    if shift_mm > LARGEST_SHIFT_MM:
        limit = f"spheres within {LARGEST_SHIFT_MM} mm"
        comparison.differs("patient before the tracker", limit, f"moved by {shift_mm:.2f} mm")
    else:
        comparison.note(f"patient: spheres within {shift_mm:.2f} mm of where the tracker saw them")
    _compare_base(engine, recorded, seen, comparison)
    return True


def shift_of_spheres_mm(recorded_mm: Array, seen_mm: Array) -> float | None:
    """Rms shift of the recorded spheres that are seen near their places; None when they are too few."""
    if not len(seen_mm):
        return None
    apart_mm = np.linalg.norm(recorded_mm[:, None] - seen_mm[None], axis=2).min(axis=1)
    near_mm = apart_mm[apart_mm < NEAR_MM]
    return float(np.sqrt(np.mean(near_mm**2))) if len(near_mm) >= FEWEST_SPHERES else None


def _spheres_of(engine: Engine, recorded: GlobalLocalization) -> Array:
    """Those on the head, where they are matched; else all that were recorded."""
    points_mm = np.asarray(recorded.points_tracker_mm, dtype=float).reshape(-1, 3)
    matched = engine.case.find(Correspondence, None)
    return points_mm if matched is None else points_mm[[pair[1] for pair in matched.result.pairs]]


def _compare_base(
    engine: Engine, recorded: GlobalLocalization, seen: Sighting, comparison: Comparison
) -> None:
    workcell = engine.setting.workcell
    if not workcell.at_home:
        comparison.note("robot base: compared when the arm is home")
        return
    if seen.tracker_from_marker is None:
        comparison.differs("robot base", "the frame on the arm in sight", "the tracker does not see it")
        return
    flange = workcell.arm.kinematics.flange_pose(workcell.joints_rad())
    frame = workcell.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    robot_from_marker = flange @ workcell.flange_from(MountedTool.STEREO_HEAD) @ frame
    expected = recorded.robot_from_tracker.transform.inverse() @ robot_from_marker
    moved_mm = float(np.linalg.norm(seen.tracker_from_marker.translation_mm - expected.translation_mm))
    if moved_mm > LARGEST_BASE_SHIFT_MM:
        limit = f"the frame on the arm within {LARGEST_BASE_SHIFT_MM} mm"
        comparison.differs("robot base before the tracker", limit, f"moved by {moved_mm:.2f} mm")
    else:
        comparison.note(f"robot base: the frame on the arm within {moved_mm:.2f} mm of its place")


def _look(engine: Engine) -> Sighting:
    workcell = engine.setting.workcell
    tracker = workcell.tracker
    tracker.activate()
    try:
        frames, _ = fresh_frames(tracker, engine.setting.clock, lambda _share: None)
    finally:
        if tracker.state is not Lifecycle.FAULT:
            tracker.deactivate()
    try:
        marker = average_pose(frames, workcell.calibrations.tracker_frame.tool)
    except GateFailed:
        marker = None
    groups = average_strays(frames).groups
    return Sighting(np.array([group.mean_mm for group in groups]).reshape(-1, 3), marker)
