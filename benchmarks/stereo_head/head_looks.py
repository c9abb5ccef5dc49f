"""Looks at a ball by a true stereo head, simulated independently of the measuring code.

The outline of a ball is the section of its tangent cone by the image plane. With the unit direction u to the
ball's centre and its angular radius a the cone is (x . u)^2 = cos^2 a; centre and axes follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.calibration.head_model import cameras_of, intersect_rays
from procedures.calibration.observations import Observation, ObservationSet, Outline
from procedures.calibration.pose_set import CHECK_ORIENTATIONS, PlannedLook, self_check_variants
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.config import parse_theatre
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from sim.theatre.theatre_file import theatre_content
from sim.world.rigid import inverse, matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.world.scene.model import SPHERE_RADIUS_MM, CameraTruth, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm

ENDPOINTS = {
    "polaris": "tcp://127.0.0.1:8765",
    "kuka": {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"},
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}
APPROACH = (1.0,) * 6  # every joint arrives turning in the same direction, as in `ronna-stereo`
JOINTS = (0.0, -1.3, 1.7, 0.0, 1.1, 3.1)


@dataclass(frozen=True)
class TrueHead:
    """Ground truth of a scene, with noise of the arm (mm per axis) and of the outline (px).

    The arm has no error other than that noise, unless `with_arm`: then it is the scene's own, with joint
    angles within its reach.
    """

    scene: Scene
    repeatability_mm: float = 0.015
    outline_px: float = 0.02
    with_arm: bool = False

    @cached_property
    def record(self) -> StereoHeadCalibration:
        calibration = parse_theatre(theatre_content(self.scene, ENDPOINTS, "host:", {}, 1.0)).calibration
        assert calibration is not None
        return calibration.stereo_head

    def with_twisted_camera(self, side: str, turn_rad: tuple[float, float, float]) -> TrueHead:
        """Return a copy with one camera rotated in its mount about its own axes."""
        camera: CameraTruth = getattr(self.scene, side)
        turned = matrix_from(np.zeros(3), rotation_from_vector(turn_rad)) @ matrix_of(camera.camera_from_tool)
        changed = camera.model_copy(update={"camera_from_tool": pose_of(turned)})
        return replace(self, scene=self.scene.model_copy(update={side: changed}))

    def observe(self, look: PlannedLook, ball_mm: ArrayLike, generator: np.random.Generator) -> Observation:
        """Simulate an observation from the pose that the arm really reaches for a planned look.

        Raises the errors of the inverse kinematics for a pose out of reach, if there is an arm.
        """
        record = self.record.flange_from_tool
        nominal = look.pose.as_matrix() @ inverse(matrix_of(record))
        joints: JointVector = JOINTS
        true = nominal.copy()
        if self.with_arm:
            joints, true = self._with_its_arm(nominal)
        true[:3, 3] += generator.normal(0.0, self.repeatability_mm, 3)
        tool = true @ matrix_of(self.scene.mount.flange_from_tool_true)
        in_tool = inverse(tool) @ np.append(ball_mm, 1.0)
        left, right = (
            self._outline(camera, (matrix_of(camera.camera_from_tool) @ in_tool)[:3], generator)
            for camera in (self.scene.left, self.scene.right)
        )
        return Observation(
            joints_rad=joints,
            robot_from_flange=pose_of(nominal),
            left=left,
            right=right,
            orientation=look.orientation,
        )

    def _with_its_arm(self, nominal: np.ndarray) -> tuple[JointVector, np.ndarray]:
        """Return the joint angles for a nominal flange pose, and the true flange pose they produce."""
        truth = self.scene.arm
        model, home = kr6_r900(truth.variant), [math.radians(angle) for angle in truth.home_deg]
        near = (home[0], home[1], home[2], home[3], home[4], home[5])
        pose = Pose.from_transform(Transform.from_matrix(Frame.ROBOT, Frame.FLANGE, nominal))
        joints = model.solve_branch(pose, model.branch_of(near), near)
        return joints, TrueArm(truth, self.scene.seed).moving(joints, APPROACH)

    def _outline(self, camera: CameraTruth, centre_mm: Array, generator: np.random.Generator) -> Outline:
        distance = np.linalg.norm(centre_mm)
        u = centre_mm / distance
        cosine_squared = 1.0 - (SPHERE_RADIUS_MM / distance) ** 2
        conic = np.outer(u, u) - cosine_squared * np.eye(3)
        block, side = conic[:2, :2], conic[:2, 2]
        middle = -np.linalg.solve(block, side)
        level = -(conic[2, 2] + side @ middle)
        axes = np.sort(np.sqrt(level / np.linalg.eigvalsh(block)))[::-1]
        k1 = camera.distortion[0]
        seen = middle * (1.0 + k1 * (middle @ middle)) * camera.focal_px + camera.principal_point_px
        seen = seen + generator.normal(0.0, self.outline_px, 2)
        major, minor = axes * camera.focal_px[0] + generator.normal(0.0, self.outline_px)
        variance = self.outline_px**2
        return Outline(
            centre_px=(float(seen[0]), float(seen[1])),
            axes_px=(float(major), float(minor)),
            covariance_px2=((variance, 0.0), (0.0, variance)),
            quality=0.95,
        )

    def tool_centre_error_mm(self, record: StereoHeadCalibration) -> float:
        """Return a record's error for a ball at the true tool centre, in the flange frame."""
        pixels = []
        for camera in (self.scene.left, self.scene.right):
            x, y, z = matrix_of(camera.camera_from_tool)[:3, 3]
            ideal = np.array([x / z, y / z])
            k1 = camera.distortion[0]
            pixels.append(
                [ideal * (1.0 + k1 * (ideal @ ideal)) * camera.focal_px + camera.principal_point_px]
            )
        seen, _ = intersect_rays(cameras_of(record), np.array(pixels[0]), np.array(pixels[1]))
        return float(np.linalg.norm(seen[0] - matrix_of(self.scene.mount.flange_from_tool_true)[:3, 3]))


def true_head(
    seed: int = 3, *, repeatability_mm: float = 0.015, outline_px: float = 0.02, with_arm: bool = False
) -> TrueHead:
    return TrueHead(draw_scene("mini", seed=seed), repeatability_mm, outline_px, with_arm)


def observation_set(head: TrueHead, observations: Iterable[Observation]) -> ObservationSet:
    """Build an observation set as stored by `calibrate`."""
    return ObservationSet(
        created=datetime(2026, 11, 20, 9, 0, tzinfo=UTC),
        serials=(head.scene.left.serial, head.scene.right.serial),
        arm_variant="kr6_r900_sixx",
        start=head.record,
        observations=tuple(observations),
    )


def check_looks(reference: Rotation, ball_mm: ArrayLike) -> tuple[PlannedLook, ...]:
    """Return the looks of the self-check, assuming that all are reachable."""
    return tuple(self_check_variants(reference, ball_mm, number)[0] for number in range(CHECK_ORIENTATIONS))
