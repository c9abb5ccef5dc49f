"""Watch over the room as the global localization found it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from procedures.guards.clamp_frame import FrameOnClamp
from procedures.guards.room_reading import RoomReading
from procedures.guards.room_watch import RoomWatch
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.workcell import Workcell


def build_watch(
    workcell: Workcell, name: str, localized: GlobalLocalization, pairs: Sequence[tuple[int, int]] | None
) -> RoomWatch:
    """Build the watch over a named localization, limited to the matched spheres if `pairs` are given.

    A tracker that was moved since is where the journal has it.
    """
    spheres = np.asarray(localized.points_tracker_mm, dtype=float).reshape(-1, 3)
    if pairs is not None:
        spheres = spheres[[room for _, room in pairs]]
    flange = workcell.flange_pose(localized.joints_rad)
    begun = RoomReading(flange, np.zeros(3), spheres, frames=localized.frames)
    on_clamp, frame = localized.tracker_from_patient, workcell.patient_frame
    clamp = None
    if on_clamp is not None and frame is not None:
        clamp = FrameOnClamp(on_clamp.transform, np.array(workcell.tracker.markers_mm[frame]))
    return RoomWatch(
        name,
        localized.robot_from_tracker.transform,
        spheres,
        [begun],
        on_clamp=clamp,
        tracker=workcell.tracker_move(name),
        tracker_moved=partial(workcell.record_tracker_move, name),
    )
