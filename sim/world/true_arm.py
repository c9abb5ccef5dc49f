"""True arm: the flange pose at given encoder angles.

The controller relies on its encoders and the nominal chain. The true flange differs by link errors, and by
errors between encoder and joint: resolution, offset, two harmonics per turn, sag under gravity, backlash.
Long motion warms the arm, which displaces the flange and lengthens the links. At rest there is also a small
repeatability error, which depends on the number of the motion only.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import cos, exp, sin
from typing import TypeVar

import numpy as np
import pinocchio as pin

from sim.world.descriptions import DESCRIPTIONS
from sim.world.noise import noise
from sim.world.nominal_arm import AXES, RobotDescription
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, rotation_from_vector
from sim.world.scene.model import ArmTruth, LinkError

Real = TypeVar("Real", float, Matrix)

ROTATION_WEIGHT_MM = 300.0  # a radian of orientation counts as this distance: about half the reach
DAMPING = 1e-4  # in the least squares, relative to a Jacobian in hundreds of mm/rad
POSITION_TOLERANCE_MM = 1e-6
STEPS_LIMIT = 30

DEVICE = "arm"  # noise key
DRIFT = "arm warmth"  # noise key of the direction of thermal displacement
# The backlash of a joint is the full play on a reversal: it rests half of it to either side.
FLANK_SHARE = 0.5


def arm_seed(scene_seed: int, role: ArmRole) -> int:
    """Return the seed of an arm's own random errors: two arms share none."""
    return scene_seed if role is ArmRole.MASTER else int(noise(scene_seed, role.value, 0).integers(2**31))


class TrueArm:
    """True flange pose as a function of encoder angles, gear flanks and motion number."""

    def __init__(self, truth: ArmTruth, seed: int) -> None:
        arm = DESCRIPTIONS[truth.variant]
        self._chain = JointChain(arm, truth.links)
        self._seed = seed
        self._repeatability_mm = truth.repeatability_mm
        direction = noise(seed, DRIFT, 0).normal(size=3)
        self._drift_mm = truth.thermal_drift_mm * direction / np.linalg.norm(direction)
        self._growth = truth.thermal_growth
        self._warms = truth.thermal_drift_mm > 0.0 or truth.thermal_growth > 0.0
        self._step_rad = truth.encoder_step_rad
        self._thermal_time_s = truth.thermal_time_s
        self._sag_rad = truth.sag_rad
        self._arm = arm
        self._joints = tuple(
            zip(
                truth.joint_offset_rad,
                truth.harmonic_1_rad,
                truth.harmonic_1_phase_rad,
                truth.harmonic_2_rad,
                truth.harmonic_2_phase_rad,
                (FLANK_SHARE * value for value in truth.backlash_rad),
                strict=True,
            )
        )

    def moving(self, encoders_rad: Sequence[float], flanks: Sequence[float], moved_s: float = 0.0) -> Matrix:
        """Return the flange pose (4, 4) while the arm is moving.

        `flanks` is each joint's position in its backlash, -1 to 1; `moved_s` the time in motion so far.
        """
        if self._step_rad > 0.0:
            encoders_rad = [self._step_rad * round(angle / self._step_rad) for angle in encoders_rad]
        pose = self._chain.flange(self._joint_angles(encoders_rad, flanks))
        if self._warms:
            warmth = 1.0 - exp(-moved_s / self._thermal_time_s)
            pose[:3, 3] *= 1.0 + warmth * self._growth  # all links grow alike, so the arm keeps its shape
            pose[:3, 3] += warmth * self._drift_mm
        return pose

    def at_rest(
        self, encoders_rad: Sequence[float], flanks: Sequence[float], motion_number: int, moved_s: float = 0.0
    ) -> Matrix:
        """Return the flange pose (4, 4) at rest after motion `motion_number`."""
        pose = self.moving(encoders_rad, flanks, moved_s)
        # a shift of the flange: any mounted tool is displaced alike
        pose[:3, 3] += noise(self._seed, DEVICE, motion_number).normal(0.0, self._repeatability_mm, 3)
        return pose

    def _joint_angles(self, encoders_rad: Sequence[float], flanks: Sequence[float]) -> list[float]:
        angles = [
            angle + offset + first * sin(angle + phase_1) + second * sin(2.0 * angle + phase_2) + half * flank
            for angle, flank, (offset, first, phase_1, second, phase_2, half) in zip(
                encoders_rad, flanks, self._joints, strict=True
            )
        ]
        upper, fore = cos(encoders_rad[1]), cos(encoders_rad[1] + encoders_rad[2])
        of_shoulder, of_elbow = sag_levers(self._arm, upper, fore)
        angles[1] += self._sag_rad[0] * of_shoulder
        angles[2] += self._sag_rad[1] * of_elbow
        return angles


def sag_levers(arm: RobotDescription, upper: Real, fore: Real) -> tuple[Real, Real]:
    """Return the shares of a stretched arm's sag at shoulder and elbow.

    `upper` and `fore` are the cosines of the elevations of upper arm and forearm. Weight turns both axes of
    the stretched arm in their positive direction: KUKA's point to its left, those of Universal Robots to its
    right, but there it extends along -x. The moment about an axis grows with the horizontal distance of its
    load: full stretched out, zero upright, then reversed.
    """
    upper_mm, fore_mm = arm.upper_arm_mm, arm.forearm_mm
    return (upper_mm * upper + fore_mm * fore) / (upper_mm + fore_mm), fore


class JointChain:
    """Pinocchio joint chain of an arm, nominal or with link errors: flange in $ROBROOT, mm and rad.

    `links` are the errors of the links after A1 .. A6, each added at the link's far end. One chain belongs to
    one thread: Pinocchio computes in the chain's own memory.
    """

    def __init__(self, arm: RobotDescription, links: Sequence[LinkError] | None = None) -> None:
        self._model, self._flange = build_model(arm, None if links is None else tuple(links))
        self._data = self._model.createData()
        self._place = self._data.oMf[self._flange]  # a view: the kinematics write into it
        self._q = np.zeros(AXES)

    def flange(self, joints_rad: Sequence[float] | Matrix) -> Matrix:
        """Return the flange pose (4, 4)."""
        self._q[:] = joints_rad
        pin.framesForwardKinematics(self._model, self._data, self._q)
        pose: Matrix = self._place.homogeneous
        return pose

    def joints_at(self, flange: Matrix, near_rad: Sequence[float]) -> list[float] | None:
        """Solve for the joint angles of a flange pose from nearby angles, or return None on failure.

        Damped least squares, which may not converge near a singularity.
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


@lru_cache(maxsize=8)  # shared: chains only read it and compute in their own data
def build_model(arm: RobotDescription, links: tuple[LinkError, ...] | None) -> tuple[pin.Model, int]:
    """Return a model without weights, shared by all, and the index of its flange frame."""
    model, parent = pin.Model(), 0
    for number, joint in enumerate(arm.joints):
        place = pin.SE3(np.eye(3), np.array(joint.origin_mm))
        if links is not None and number > 0:
            place = place * _placement_error(links[number - 1])
        axis = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, axis, place, joint.name)
    end = pin.SE3(rotation_from_vector(arm.flange_turn_rad), np.array(arm.flange_mm))
    if links is not None:
        end = end * _placement_error(links[AXES - 1])
    return model, model.addFrame(pin.Frame("flange", parent, 0, end, pin.FrameType.OP_FRAME))


def _placement_error(link: LinkError) -> pin.SE3:
    return pin.SE3(rotation_from_vector(link.rotation_rad), np.array(link.translation_mm))


def rotation_vector(rotation: Matrix) -> Matrix:
    """Return the rotation vector (axis times angle, rad) of a rotation matrix (3, 3)."""
    vector: Matrix = pin.log3(rotation)
    return vector
