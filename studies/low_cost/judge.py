"""Judgement by truth: where tip and flange really are, as no device of the experiment tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.registration.rigid_fit import fit_rigid, residuals
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arrays import Array
from ronna_hw.devices.robot import JointMove
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from sim.world.rigid import matrix_of
from sim.world.scene.model import Scene
from sim.world.world import World
from studies.campaign.study import Sums
from studies.low_cost.arms import PositionedArm
from studies.low_cost.figures import DimensionSource, Place, Quantity
from studies.low_cost.positioning import TipModel
from studies.low_cost.targets import StudiedTarget

CYCLES = 30  # of ISO 9283, each through all poses in one order


@dataclass(frozen=True)
class TrueError:
    """True distance of the tip from its target, and angle between the tool and the wanted orientation."""

    distance_mm: float
    angle_rad: float

    def sums(self, place: Place) -> Sums:
        return {
            place.key(Quantity.ERROR_MM): self.distance_mm,
            place.key(Quantity.ANGLE_DEG): float(np.degrees(self.angle_rad)),
        }


class Judge:
    """Reads the truth of a world."""

    def __init__(self, scene: Scene, world: World) -> None:
        self._world = world
        self._robot_from_ct = matrix_of(scene.head.robot_from_ct)
        self._flange_from_tip = matrix_of(scene.mount.flange_from_tool_true)

    def error(self, target: StudiedTarget) -> TrueError:
        tip = self._world.arm().robot_from_flange @ self._flange_from_tip
        wanted = self._robot_from_ct @ target.ct_from_tool.as_matrix()
        turned = Rotation.from_matrix(wanted[:3, :3].T @ tip[:3, :3]).magnitude()
        return TrueError(float(np.linalg.norm(tip[:3, 3] - wanted[:3, 3])), float(turned))

    def tip_mm(self) -> Array:
        """Return the place (3,) of the tip in the robot frame."""
        return np.asarray((self._world.arm().robot_from_flange @ self._flange_from_tip)[:3, 3])


def measure_repeatability_mm(
    arm: PositionedArm, judge: Judge, model: TipModel, poses: list[Transform]
) -> float:
    """Return the largest repeatability of the tip at any pose, by ISO 9283: mean distance plus 3 sd."""
    joints = [model.joints(pose) for pose in poses]
    places = np.empty((CYCLES, len(poses), 3))
    for cycle in range(CYCLES):
        for pose, target in enumerate(joints):
            arm.move(JointMove(target))
            places[cycle, pose] = judge.tip_mm()
    away = np.linalg.norm(places - places.mean(axis=0), axis=2)
    return float((away.mean(axis=0) + 3.0 * away.std(axis=0, ddof=1)).max())


def measure_accuracy_mm(
    arm: PositionedArm,
    judge: Judge,
    model: TipModel,
    poses: list[Transform],
    models: Mapping[DimensionSource, Kinematics],
) -> dict[DimensionSource, Array]:
    """Return the errors (n,) of the tip's place by each kinematics, over poses that the model moves to.

    Each is fitted to the true places by a rigid transform first, as an independent instrument's frame has to
    be: where the base stands is not the arm's error.
    """
    read: list[JointVector] = []
    true = np.empty((len(poses), 3))
    for number, pose in enumerate(poses):
        read.append(arm.move(JointMove(model.joints(pose))).joints_rad)
        true[number] = judge.tip_mm()
    errors = {}
    for name, kinematics in models.items():
        computed = np.array(
            [(kinematics.flange_pose(joints) @ model.flange_from_tip).translation_mm for joints in read]
        )
        errors[name] = np.linalg.norm(residuals(fit_rigid(computed, true), computed, true), axis=1)
    return errors


def distance_errors_mm(found_mm: Array, true_mm: Array) -> Array:
    """Return the errors of all distances between spheres found (n, 3), paired with the nearest true ones."""
    nearest = np.linalg.norm(true_mm[:, None] - found_mm[None], axis=2).argmin(axis=1)
    rows, columns = np.triu_indices(len(true_mm), 1)
    true, found = (np.linalg.norm(one[rows] - one[columns], axis=1) for one in (true_mm, found_mm[nearest]))
    return np.asarray(found - true)


def named_pose(place_mm: Array, rotation: Rotation) -> Transform:
    return Transform.of(
        Frame.ROBOT, Frame.TOOL, translation_mm=place_mm, quaternion_wxyz=rotation.as_quat(scalar_first=True)
    )
