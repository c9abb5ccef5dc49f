"""Before and after the motions of a step: have head, cart and tracker stayed where they were localized?"""

from __future__ import annotations

import numpy as np

from procedures.engine.context import StepContext
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_watch import RoomReading, RoomWatch
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization, fresh_frames, mean_pose
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform

FRAMES = 12  # 0.2 s: the noise of a frame's place is then 0.02 mm, of a sphere 0.05 mm
LEAST_SHARE = 0.5  # of the frames that must show what is averaged

ROOM_READS = (GlobalLocalization, Correspondence)  # what every step that checks the room must declare


def check_room(context: StepContext, where: str) -> None:
    """Read the tracker and compare with the global localization and the readings since.

    The arm rests meanwhile. What is not seen is a finding. Raises PRO-019 and PRO-020; then the localization
    and all that descends from it are superseded.
    """
    watch = _watch(context)
    try:
        findings = watch.check(_read(context, watch))
    except (BaseShifted, PatientMoved) as moved:
        context.setting.workspace.drop(RoomWatch)  # the way out is not to be stopped by the same
        context.void(GlobalLocalization, moved)
        raise
    for finding in findings:
        context.find(f"{where}: {finding}")


def head_hidden(context: StepContext) -> bool:
    """Whether the tracker, when it looked last, saw too little of the head past the arm as it stands now."""
    watch, workcell = context.setting.workspace.find(RoomWatch), context.workcell
    if watch is None or watch.hidden_from is None:
        return False
    return watch.hides_head(workcell.arm.kinematics.flange_pose(workcell.joints_rad()))


def _watch(context: StepContext) -> RoomWatch:
    """The watch over the standing localization; a new one begins with that."""
    localized = context.result(GlobalLocalization)
    name = context.identifier(GlobalLocalization)
    watch = context.setting.workspace.find(RoomWatch)
    if watch is None or watch.localization != name:
        pairs = context.result(Correspondence).pairs
        spheres = np.array(localized.points_tracker_mm)[[room for _, room in pairs]]
        flange = context.workcell.arm.kinematics.flange_pose(localized.joints_rad)
        begun = RoomReading(flange, np.zeros(3), spheres)
        watch = RoomWatch(name, localized.robot_from_tracker.transform, spheres, [begun])
        context.setting.workspace.keep(watch)
    return watch


def _read(context: StepContext, watch: RoomWatch) -> RoomReading:
    workcell, tracker = context.workcell, context.workcell.tracker
    tracker.activate()
    try:
        frames, _ = fresh_frames(tracker, context.setting.clock, lambda _share: None, FRAMES)
    finally:
        if tracker.state is not Lifecycle.FAULT:
            tracker.deactivate()
    calibration = workcell.calibrations.tracker_frame
    robot_from_flange = workcell.arm.kinematics.flange_pose(workcell.joints_rad())
    groups = average_strays(frames).groups
    spheres = np.array([group.mean_mm for group in groups]).reshape(-1, 3)
    seen = mean_pose(frames, calibration.tool, round(LEAST_SHARE * FRAMES))
    frame_mm = None
    if seen is not None:
        by_arm: Transform = (
            robot_from_flange
            @ workcell.flange_from(MountedTool.STEREO_HEAD)
            @ calibration.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
        )
        frame_mm = (watch.robot_from_tracker @ seen).translation_mm - by_arm.translation_mm
    return RoomReading(robot_from_flange, frame_mm, spheres)
