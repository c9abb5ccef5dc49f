"""Readings of head, head clamp and arm with the tracker's own noise, of the scene's three rigid bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.guards.clamp_frame import FrameOnClamp
from procedures.guards.room_reading import RoomReading
from procedures.guards.room_watch import RoomWatch
from ronna_hw.frames import Frame, Transform
from sim.polaris.measurement.optics import Optics
from sim.polaris.measurement.tracking_rules import fit_rigid_body
from sim.polaris.unit.model import SPECTRA
from sim.world.rigid import Matrix, apply, inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import MARKER_FROM_HEAD_MM, add_patient_frame, draw_scene

Array = NDArray[np.float64]

HOME = Transform.of(Frame.ROBOT, Frame.FLANGE, translation_mm=(500.0, 0.0, 600.0))
STILL = (0.0, 0.0, 0.0)
LOCALIZED_FRAMES = 60


@lru_cache(maxsize=20)
def scene_of(seed: int) -> Scene:
    return add_patient_frame(draw_scene("mini", seed=seed))


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
        self._on_arm_mm = np.array(scene.tracker.tools[0].markers_mm)
        above = apply(robot_from_ct, scene.head.centre_ct_mm) + MARKER_FROM_HEAD_MM
        self._arm = matrix_from(above, self._robot_from_tracker[:3, :3])
        on_clamp, spheres, on_arm_mm = self._see(LOCALIZED_FRAMES, np.eye(4), STILL, STILL)
        pose = Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, self._robot_from_tracker)
        self._by_arm_mm = pose.apply(on_arm_mm)
        begun = RoomReading(HOME, np.zeros(3), spheres, frames=LOCALIZED_FRAMES, settled=True)
        clamp = FrameOnClamp(on_clamp, self._on_clamp_mm)
        self.watch = RoomWatch("trial", pose, spheres, [begun], on_clamp=clamp)

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
    ) -> RoomReading:
        """A reading with spheres and frame on the clamp moved so far, in the robot frame."""
        on_clamp, spheres, on_arm_mm = self._see(
            frames, np.eye(4) if pushed is None else pushed, head_mm, clamp_mm
        )
        return RoomReading(
            HOME,
            self.watch.robot_from_tracker.apply(on_arm_mm) - self._by_arm_mm,
            spheres[:0] if hidden else spheres,
            frames=frames,
            settled=True,
            arm_frame_mm=on_arm_mm,
            on_clamp=on_clamp,
        )

    def _see(
        self, frames: int, pushed: Matrix, head_mm: ArrayLike, clamp_mm: ArrayLike
    ) -> tuple[Transform, Array, Array]:
        on_clamp = np.add(apply(self._clamp, self._on_clamp_mm), clamp_mm)
        places = [on_clamp, np.add(self._spheres_mm, head_mm), apply(self._arm, self._on_arm_mm)]
        points = apply(inverse(pushed @ self._robot_from_tracker), np.vstack(places))
        sight = self._optics.sight(points)
        seen = sight.measured(self.generator.standard_normal(points.shape) / math.sqrt(frames))
        if hasattr(self, "watch"):  # as the watch reads it
            seen = self.watch.tracker.move.inverse().apply(seen)
        clamp, spheres, arm = np.split(seen, [len(on_clamp), len(on_clamp) + len(self._spheres_mm)])
        fitted = fit_rigid_body(self._on_clamp_mm, clamp)
        pose = Transform.from_matrix(
            Frame.TRACKER, Frame.PATIENT, matrix_from(fitted.translation_mm, fitted.rotation)
        )
        return pose, spheres, fit_rigid_body(self._on_arm_mm, arm).translation_mm
