"""Watch over the room as the global localization found it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from procedures.guards.room_watch import FlangePose, RoomWatch
from procedures.room.estimate import RoomEstimate
from procedures.room.model import Places, RoomModel, TrackedArm
from procedures.room.motion import RoomMotion
from procedures.room.sighting import Rest, SeenFrame, Sighting, Tracked, expect_frame, expect_spheres
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import KnownBases, RegisteredRobot
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import flange_from_marker
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.config import ProcedureSettings
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector


@dataclass(frozen=True)
class LocalizedRoom:
    """Global localization: spheres (n, 3) mm and the frame on the clamp, tracker frame.

    The arm was at `joints_rad`, with the frame on it of markers (m, 3) mm. By it, the localization has where
    the tracker is.
    """

    robot_from_tracker: Transform
    spheres_mm: Array
    joints_rad: JointVector
    arm_markers_mm: Array
    frames: int
    on_clamp: Transform | None = None
    clamp_markers_mm: Array | None = None

    @property
    def places(self) -> Places:
        """Expected place of the head."""
        return Places(self.spheres_mm, None if self.on_clamp is None else self.on_clamp.as_matrix())

    def watch(self, localization: str, arm: TrackedArm, flange_pose: FlangePose) -> RoomWatch:
        """Begin the watch, with the localization as its first look.

        Motions are told about the middle of the spheres; of a head without any, about the frame on its clamp.
        """
        to_robot, middle_mm = self.robot_from_tracker, self.spheres_mm
        if not len(middle_mm) and self.on_clamp is not None:
            middle_mm = self.on_clamp.translation_mm[None]
        centre_mm = np.asarray(to_robot.apply(middle_mm)).mean(axis=0)
        tracker = to_robot.as_matrix()
        model = RoomModel({Tracked.ARM: arm}, tracker, centre_mm, len(self.spheres_mm))
        flange = flange_pose(self.joints_rad, None).as_matrix()
        on_arm = np.linalg.inv(tracker) @ flange @ arm.flange_from_marker
        frames = {Tracked.ARM: self._expect(on_arm, self.arm_markers_mm)}
        if self.places.clamp is not None and self.clamp_markers_mm is not None:
            frames[Tracked.CLAMP] = self._expect(self.places.clamp, self.clamp_markers_mm)
        spheres = expect_spheres(self.spheres_mm, self.frames)
        look = Sighting({Tracked.ARM: Rest(self.joints_rad)}, spheres, frames)
        estimate = RoomEstimate(model).add(model.rows(look, {Tracked.ARM: flange}, self.places))
        return RoomWatch(
            localization,
            to_robot,
            estimate,
            {Tracked.ARM: flange_pose},
            [look],
            [self.places],
            clamp_markers_mm=self.clamp_markers_mm,
        )

    def _expect(self, pose: Array, markers_mm: Array) -> SeenFrame:
        return expect_frame(pose[:3, 3], pose[:3, :3], markers_mm, self.frames)


def build_watch(
    workcell: Workcell,
    settings: ProcedureSettings,
    name: str,
    localized: GlobalLocalization,
    pairs: Sequence[tuple[int, int]] | None,
    points_mm: Mapping[str, Array] | None = None,
    bases: KnownBases | None = None,
    followed: RegisteredRobot | None = None,
) -> RoomWatch:
    """Build the watch over a named localization, limited to the matched spheres if `pairs` are given.

    `points_mm` are the targets (3,), robot frame, by name; `bases` and `followed` as for `bring_up_to_date`.
    The looks that the journal has since, and where it has the tracker, are taken up.
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
    arm = TrackedArm(
        workcell.master.arm.kinematics.chain,
        ErrorSizes.stated(settings, workcell.calibrations.arm),
        flange_from_marker(workcell).as_matrix(),
        find_arm(workcell.master.arm.kinematics.name).repeatability_mm,
    )
    watch = room.watch(name, arm, workcell.master.calibrated.flange_pose)
    watch.points_mm = points_mm or {}
    watch.tracker = workcell.tracker_move(name)
    watch.tracker_moved = partial(workcell.record_tracker_move, name)
    if pairs is not None:  # before the match the spheres have other numbers
        watch.keep = partial(workcell.record_look, name)
        watch.restore(workcell.looks(name))
    bring_up_to_date(watch, workcell, settings, bases, followed)
    return watch


def bring_up_to_date(
    watch: RoomWatch,
    workcell: Workcell,
    settings: ProcedureSettings,
    bases: KnownBases | None,
    followed: RegisteredRobot | None,
) -> None:
    """Take the assistant in once its base is known, and expect a followed head at its new place."""
    if bases is not None and bases != watch.bases:
        take_in_assistant(watch, workcell, settings, bases)
    if followed is None or (move := followed.followed) is None:
        watch.follow(None)
        return
    on_clamp = None if move.tracker_from_patient is None else move.tracker_from_patient.transform
    watch.follow(np.asarray(move.spheres_tracker_mm, dtype=float), on_clamp)


def take_in_assistant(
    watch: RoomWatch, workcell: Workcell, settings: ProcedureSettings, known: KnownBases
) -> RoomMotion | None:
    """Take the assistant into a watch; return the motion that the looks show with it, or None."""
    assistant, base = workcell.assistant, known.robot_from_base.transform
    kinematics = assistant.arm.kinematics
    arm = TrackedArm(
        kinematics.chain,
        ErrorSizes.stated(settings, workcell.calibrations.assistant_arm),
        known.flange_from_frame.transform.as_matrix(),
        find_arm(kinematics.name).repeatability_mm,
        base.as_matrix(),
    )

    def flange_pose(joints_rad: JointVector, sides: Sequence[int] | None) -> Transform:
        return base @ assistant.flange_pose(joints_rad, sides)

    return watch.take_in_assistant(known, arm, flange_pose, known.first_look)
