"""Looks at spheres by a random arm of parameter set S: the simulator's own arm, without wires and images."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.arm_model import ArmLooks, SphereLook
from procedures.calibration.pose_set import plan_centred_looks
from procedures.steps.calibration.sphere_looks import flanks_of
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.config import parse_theatre
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame
from sim.theatre.theatre_file import theatre_content
from sim.world.rigid import matrix_of
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm

KINEMATICS = kr6_r900(SIXX)
ENDPOINTS = {
    "polaris": "serial:///dev/pts/9",
    "kuka": {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"},
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}
MADE = datetime(2026, 1, 1, tzinfo=UTC)
DOWN = Rotation.from_matrix(KINEMATICS.flange_pose(KINEMATICS.home_rad).rotation_matrix)
STEREO_SIGMA_MM = 0.005


@dataclass(frozen=True)
class LookingArm:
    """The true arm of a scene with the stereo head on it, and its record."""

    scene: Scene
    true: TrueArm
    head: StereoHeadCalibration

    @classmethod
    def of(cls, seed: int) -> LookingArm:
        """The arm of the mini scene with this seed."""
        scene = draw_scene("mini", seed=seed)
        calibrations = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
        assert calibrations is not None
        return cls(scene, TrueArm(scene.arm, seed), calibrations.stereo_head)

    def true_tool(self, joints_rad: object, flanks: object, motion: int) -> RigidTransform:
        """Where the tool centre truly is, at rest after a motion of that number."""
        flange = self.true.at_rest(joints_rad, flanks, motion)  # type: ignore[arg-type]
        return RigidTransform.from_matrix(flange @ matrix_of(self.scene.mount.flange_from_tool_true))

    def looks(self, count: int, validation: int, spheres_mm: object, *, same_side: bool = False) -> ArmLooks:
        """So many looks in turn at spheres (k, 3) in the robot frame."""
        generator = np.random.default_rng(self.scene.seed)
        tool = self.head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        places = np.reshape(np.asarray(spheres_mm, dtype=float), (-1, 3))
        found: list[SphereLook] = []
        number = 0
        while len(found) < count + validation:
            sphere = number % len(places)
            (planned,) = plan_centred_looks(DOWN, places[sphere], 1, first=number)
            number += 1
            try:
                flange = Pose.from_transform(planned.pose @ tool.inverse())
                joints = KINEMATICS.solve_branch(
                    flange, KINEMATICS.branch_of(KINEMATICS.home_rad), KINEMATICS.home_rad
                )
            except LimitError:
                continue
            flanks = flanks_of(0 if same_side else number, len(joints))
            seen = self.true_tool(joints, flanks, number).inv().apply(places[sphere])
            seen = seen + generator.normal(0.0, STEREO_SIGMA_MM, 3)
            found.append(
                SphereLook(
                    sphere=sphere,
                    joints_rad=joints,
                    flanks=flanks,
                    point_mm=tuple(seen.tolist()),
                    covariance_mm2=tuple(map(tuple, (STEREO_SIGMA_MM**2 * np.eye(3)).tolist())),
                    validation=len(found) >= count,
                )
            )
        return ArmLooks(
            created=MADE, arm=KINEMATICS.name, serials=("L", "R"), stereo_head=self.head, looks=tuple(found)
        )


SPHERES_MM = ((520.0, -60.0, 260.0), (600.0, -20.0, 300.0), (560.0, 70.0, 280.0), (480.0, 40.0, 300.0))
