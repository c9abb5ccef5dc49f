"""Readings of head, head clamp and arm with the tracker's own noise, of the scene's three rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from remembering_arm import RememberingArm
from room_looks import room_reading_of, seen_frame

from procedures.guards.room_reading import RoomReading
from procedures.guards.room_watch import RoomWatch
from procedures.room.sighting import SEATING_MM, SeenFrame, average_frame
from procedures.steps.clinical.localized_room import LocalizedRoom
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.frames import Frame, Transform
from sim.polaris.measurement.optics import Optics
from sim.polaris.measurement.tracking_rules import fit_rigid_body
from sim.polaris.unit.model import SPECTRA
from sim.world.rigid import Matrix, apply, inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import MARKER_FROM_HEAD_MM, add_patient_frame, draw_scene

KR6 = kr6_r900(SIXX)
HOME_RAD = KR6.home_rad
IN_PLACE = np.eye(4)
HOME = Transform.of(Frame.ROBOT, Frame.FLANGE, translation_mm=(500.0, 0.0, 600.0))
STILL = (0.0, 0.0, 0.0)
LOCALIZED_FRAMES = 60


@lru_cache(maxsize=20)
def scene_of(seed: int) -> Scene:
    return add_patient_frame(draw_scene("mini", seed=seed))


@lru_cache(maxsize=20)
def _localized(seed: int) -> ClampedCase:
    return ClampedCase(seed, np.random.default_rng(seed))


def clamped_case(seed: int) -> ClampedCase:
    """A case of its own, as it was localized and looked at home; both are computed once for each seed."""
    return deepcopy(_localized(seed))


def push(way_mm: ArrayLike, turn_rad: ArrayLike, about_mm: ArrayLike) -> Matrix:
    """A displacement of the tracker (4, 4) in the robot frame, turned about its own place."""
    rotation = rotation_from_vector(np.asarray(turn_rad, dtype=float))
    return matrix_from(np.asarray(way_mm) + np.asarray(about_mm) - rotation @ np.asarray(about_mm), rotation)


@dataclass
class ClampedCase:
    """A watch that has localized a scene's head, and what the tracker reads afterwards."""

    seed: int
    generator: np.random.Generator
    watch: RoomWatch = field(init=False)

    def __post_init__(self) -> None:
        scene = scene_of(self.seed)
        assert scene.head.robot_from_patient_frame is not None
        self._optics = Optics(scene.tracker, self.seed, SPECTRA.volumes)
        self._robot_from_tracker = matrix_of(scene.tracker.robot_from_tracker)
        robot_from_ct = matrix_of(scene.head.robot_from_ct)
        self._spheres_mm = apply(robot_from_ct, [one.centre_ct_mm for one in scene.head.fiducials])
        self._clamp = matrix_of(scene.head.robot_from_patient_frame)
        self._on_clamp_mm = np.array(scene.tracker.tools[-1].markers_mm)
        seats_mm = self.generator.normal(0.0, SEATING_MM, self._on_clamp_mm.shape)
        self._seated_mm = self._on_clamp_mm + seats_mm
        self._on_arm_mm = np.array(scene.tracker.tools[0].markers_mm)
        above = apply(robot_from_ct, scene.head.centre_ct_mm) + MARKER_FROM_HEAD_MM
        self._arm = matrix_from(above, self._robot_from_tracker[:3, :3])
        on_clamp, spheres, _ = self._see(LOCALIZED_FRAMES, np.eye(4), STILL, STILL)
        pose = Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, self._robot_from_tracker)
        on_arm = Transform.from_matrix(Frame.ROBOT, Frame.MARKER, self._arm)
        room = LocalizedRoom(
            pose, spheres, HOME_RAD, self._on_arm_mm, LOCALIZED_FRAMES, on_clamp, self._on_clamp_mm
        )
        mount = (HOME.inverse() @ on_arm).as_matrix()
        arm = RememberingArm(KR6.chain, ErrorSizes(), mount, find_arm(KR6.name).repeatability_mm)
        self.watch = room.watch("trial", arm, lambda _joints, _sides: HOME)
        self.watch.points_mm = {"T1": apply(robot_from_ct, [scene.head.targets[0].target_ct_mm])[0]}
        for _ in range(3):  # as a case looks, settled home, before anything happens
            assert self.watch.compare(self.read(LOCALIZED_FRAMES)).in_place

    @property
    def tracker_mm(self) -> Array:
        return self._robot_from_tracker[:3, 3]

    def read(
        self,
        frames: int,
        *,
        hidden: bool = False,
        head_mm: ArrayLike = STILL,
        clamp_mm: ArrayLike = STILL,
        pushed: Matrix | None = None,
        cart: Matrix = IN_PLACE,
        sides: Sequence[int] | None = ONE_SIDE,
    ) -> RoomReading:
        """A reading with spheres and frame on the clamp moved so far, and the cart (4, 4), robot frame."""
        on_clamp, spheres, on_arm = self._see(
            frames, np.eye(4) if pushed is None else pushed, head_mm, clamp_mm, cart
        )
        expected = self.watch.robot_from_tracker.inverse() @ Transform.from_matrix(
            Frame.ROBOT, Frame.MARKER, self._arm
        )
        return room_reading_of(
            HOME,
            HOME_RAD,
            spheres[:0] if hidden else spheres,
            frames,
            sides=sides,
            arm=seen_frame(on_arm.as_matrix(), self._on_arm_mm, frames),
            clamp=seen_frame(on_clamp.as_matrix(), self._on_clamp_mm, frames),
            frame_mm=self.watch.robot_from_tracker.rotation_matrix
            @ (on_arm.translation_mm - expected.translation_mm),
        )

    def see_clamp_without(self, marker: int, frames: int, *, is_told: bool = True) -> SeenFrame:
        """The frame on the clamp, unmoved, with one marker hidden, and whether the tracker says so."""
        seen = np.arange(len(self._on_clamp_mm)) != marker
        body_mm = self._on_clamp_mm[seen]
        places_mm = apply(inverse(self._robot_from_tracker), apply(self._clamp, self._seated_mm[seen]))
        sight = self._optics.sight(places_mm)
        poses = [
            _pose_of(Frame.PATIENT, body_mm, sight.measured(self.generator.standard_normal(places_mm.shape)))
            for _ in range(frames)
        ]
        listed = [(one.quaternion_wxyz, one.translation_mm) for one in poses]
        return average_frame(listed, self._on_clamp_mm, seen.astype(float) if is_told else np.ones(len(seen)))

    def _see(
        self,
        frames: int,
        pushed: Matrix,
        head_mm: ArrayLike,
        clamp_mm: ArrayLike,
        cart: Matrix = IN_PLACE,
    ) -> tuple[Transform, Array, Transform]:
        on_clamp = np.add(apply(self._clamp, self._seated_mm), clamp_mm)
        places = [on_clamp, np.add(self._spheres_mm, head_mm), apply(cart @ self._arm, self._on_arm_mm)]
        points = apply(inverse(pushed @ self._robot_from_tracker), np.vstack(places))
        sight = self._optics.sight(points)
        seen = sight.measured(self.generator.standard_normal(points.shape) / math.sqrt(frames))
        if hasattr(self, "watch"):  # as the watch reads it
            seen = self.watch.tracker.move.inverse().apply(seen)
        clamp, spheres, arm = np.split(seen, [len(on_clamp), len(on_clamp) + len(self._spheres_mm)])
        return (
            _pose_of(Frame.PATIENT, self._on_clamp_mm, clamp),
            spheres,
            _pose_of(Frame.MARKER, self._on_arm_mm, arm),
        )


def _pose_of(source: Frame, body_mm: Array, seen_mm: Array) -> Transform:
    fitted = fit_rigid_body(body_mm, seen_mm)
    return Transform.from_matrix(Frame.TRACKER, source, matrix_from(fitted.translation_mm, fitted.rotation))
