"""The arm as a chain of joints in Pinocchio: nominal, or with link errors.

One chain belongs to one thread: Pinocchio computes in the chain's own memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import radians

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from sim.world.arm.robot_description import AXES, FLANGE_PITCH_DEG, RobotDescription
from sim.world.rigid import rotation_from_vector
from sim.world.scene.model import LinkError

Matrix = NDArray[np.float64]

ROTATION_WEIGHT_MM = 300.0  # a radian of orientation counts as this distance: about half the reach
DAMPING = 1e-4  # of the least squares, relative to a Jacobian in hundreds of mm/rad
POSITION_TOLERANCE_MM = 1e-6
STEPS_LIMIT = 30


class JointChain:
    """Forward kinematics of the flange in $ROBROOT. Millimetres and radians.

    `links` are the errors of the links after A1 .. A6, each added at the link's far end.
    """

    def __init__(self, arm: RobotDescription, links: Sequence[LinkError] | None = None) -> None:
        self._model, self._flange = _model_of(arm, None if links is None else tuple(links))
        self._data = self._model.createData()
        self._q = np.zeros(AXES)

    def flange(self, joints_rad: Sequence[float] | Matrix) -> Matrix:
        """Pose (4, 4) of the flange."""
        self._q[:] = joints_rad
        pin.framesForwardKinematics(self._model, self._data, self._q)
        pose: Matrix = self._data.oMf[self._flange].homogeneous
        return pose

    def joints_at(self, flange: Matrix, near_rad: Sequence[float]) -> list[float] | None:
        """Joint angles that bring the flange to a pose, starting from nearby ones; None if it fails.

        Damped least squares: near a singularity it moves slowly and then gives up.
        """
        angles = np.array(near_rad, dtype=float)
        for _ in range(STEPS_LIMIT):
            here = self.flange(angles)
            error = np.empty(6)
            error[:3] = flange[:3, 3] - here[:3, 3]
            error[3:] = ROTATION_WEIGHT_MM * rotation_vector(flange[:3, :3] @ here[:3, :3].T)
            if float(np.abs(error).max()) < POSITION_TOLERANCE_MM:
                return [float(angle) for angle in angles]
            jacobian = pin.computeFrameJacobian(
                self._model, self._data, angles, self._flange, pin.LOCAL_WORLD_ALIGNED
            )
            jacobian[3:] *= ROTATION_WEIGHT_MM
            normal = jacobian.T @ jacobian
            normal[np.diag_indices(AXES)] += (DAMPING * ROTATION_WEIGHT_MM) ** 2
            angles += np.linalg.solve(normal, jacobian.T @ error)
        return None


@lru_cache(maxsize=8)  # a model is only read; what is computed is in a chain's own data
def _model_of(arm: RobotDescription, links: tuple[LinkError, ...] | None) -> tuple[pin.Model, int]:
    """The joints, and the number of the flange's frame."""
    model, parent = pin.Model(), 0
    for number, joint in enumerate(arm.joints):
        place = pin.SE3(np.eye(3), np.array(joint.origin_mm))
        if links is not None and number > 0:
            place = place * _error(links[number - 1])
        axis = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, axis, place, joint.name)
    end = pin.SE3(rotation_from_vector((0.0, radians(FLANGE_PITCH_DEG), 0.0)), np.zeros(3))
    if links is not None:
        end = end * _error(links[AXES - 1])
    return model, model.addFrame(pin.Frame("flange", parent, 0, end, pin.FrameType.OP_FRAME))


def _error(link: LinkError) -> pin.SE3:
    return pin.SE3(rotation_from_vector(link.rotation_rad), np.array(link.translation_mm))


def rotation_vector(rotation: Matrix) -> Matrix:
    """Axis times angle (rad) of a rotation (3, 3)."""
    vector: Matrix = pin.log3(rotation)
    return vector
