"""Watch over the room as the global localization found it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from procedures.guards.room_watch import LocalizedRoom, RoomWatch
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import flange_from_marker
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.config import ProcedureSettings
from ronna_hw.frames import Transform

Array = NDArray[np.float64]


def build_watch(
    workcell: Workcell,
    settings: ProcedureSettings,
    name: str,
    localized: GlobalLocalization,
    pairs: Sequence[tuple[int, int]] | None,
    points_mm: Mapping[str, Array] | None = None,
    followed: tuple[Array | None, Transform | None] = (None, None),
) -> RoomWatch:
    """Build the watch over a named localization, limited to the matched spheres if `pairs` are given.

    `points_mm` are the targets (3,), robot frame, by name; `followed` is where the last registration followed
    the head to. The looks that the journal has since, and where it has the tracker, are taken up.
    """
    spheres = np.asarray(localized.points_tracker_mm, dtype=float).reshape(-1, 3)
    if pairs is not None:
        spheres = spheres[[room for _, room in pairs]]
    on_clamp, frame, markers_mm = localized.tracker_from_patient, workcell.patient_frame, None
    if on_clamp is not None and frame is not None:
        markers_mm = np.array(workcell.tracker.markers_mm[frame])
    room = LocalizedRoom(
        localized.robot_from_tracker.transform,
        spheres,
        localized.joints_rad,
        np.array(workcell.tracker.markers_mm[workcell.calibrations.tracker_frame.tool]),
        localized.frames,
        None if on_clamp is None or markers_mm is None else on_clamp.transform,
        markers_mm,
    )
    watch = room.watch(
        name,
        workcell.arm.kinematics,
        ErrorSizes.stated(settings, workcell.calibrations.arm),
        flange_from_marker(workcell),
        workcell.calibrated.flange_pose,
    )
    watch.points_mm = points_mm or {}
    watch.tracker = workcell.tracker_move(name)
    watch.tracker_moved = partial(workcell.record_tracker_move, name)
    watch.keep = partial(workcell.record_look, name)
    watch.restore(workcell.looks(name), *followed)
    return watch
