"""Joint angles of many arms near planned ones: nominally at a position, or with the true tool on a sphere.

An arm ends within millimetres of its planned pose, so the Jacobian of the planned pose serves all arms: each
step leaves a fiftieth of the error, a tenth near a singularity. The number of steps is fixed, so that an
arm's result does not depend on which others are run with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.kinematics import Kinematics
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.turning import nominal_frames
from studies.errors import PoseNotSolved

Array = NDArray[np.float64]

SETTLED_MM = 1e-6  # far below any source of error
STEPS = 10


@dataclass(frozen=True)
class PlannedPoses:
    """Postures of the nominal arm: joints (p, 6), orientations robot <- tool (p, 3, 3).

    `inverse` (p, 6, 6) maps a small motion of the tool (mm, rad) to one of the joints.
    """

    tool_mm: Array  # (3,) in the flange frame, to which the nominal tool is parallel
    joints_rad: Array
    rotations: Array
    inverse: Array

    @classmethod
    def of(cls, kinematics: Kinematics, tool_mm: Array, joints_rad: Array) -> Self:
        """At joint vectors (p, 6)."""
        _, rotations = nominal_frames(kinematics.chain, joints_rad, tool_mm)
        inverse = np.empty((len(joints_rad), 6, 6))
        for place, (joints, rotation) in enumerate(zip(joints_rad.tolist(), rotations, strict=True)):
            jacobian = kinematics.jacobian(tuple(joints)).copy()
            jacobian[:3] += np.cross(jacobian[3:].T, rotation @ tool_mm).T
            inverse[place] = np.linalg.inv(jacobian)
        return cls(tool_mm, joints_rad, rotations, inverse)

    def __len__(self) -> int:
        return len(self.joints_rad)


def centred(arms: RandomArms, poses: PlannedPoses, spheres_mm: Array, flanks: Array) -> tuple[Array, Array]:
    """Joints (a, p, 6) with the true tool on spheres (p, 3), and its believed position (a, p, 3).

    The believed orientation is the planned one: the servo shifts the tool and does not turn it.
    """
    return solved(
        poses,
        lambda joints: nominal_frames(arms.chain, joints, poses.tool_mm),
        lambda joints, _: spheres_mm - arms.tool_points_mm(joints, flanks),
        (len(arms), len(poses), 6),
    )


def brought_to(arms: RandomArms, poses: PlannedPoses, places_mm: Array) -> Array:
    """Joints (a, p, 6) with the nominal tool at positions (a, p, 3) in the planned orientations."""
    joints, _ = solved(
        poses,
        lambda joints: nominal_frames(arms.chain, joints, poses.tool_mm),
        lambda _, at: places_mm - at,
        (*places_mm.shape[:-1], 6),
    )
    return joints


def solved(
    poses: PlannedPoses,
    frames: Callable[[Array], tuple[Array, Array]],
    missing: Callable[[Array, Array], Array],
    shape: tuple[int, ...],
) -> tuple[Array, Array]:
    """Joints of this shape with nothing `missing` (mm) and the tool oriented as planned; its places there.

    `frames` are the tool's places and orientations at joints. Raises STU-009.
    """
    joints = np.array(np.broadcast_to(poses.joints_rad, shape))
    for _ in range(STEPS):
        places, rotations = frames(joints)
        shift = missing(joints, places)
        turn = 0.5 * np.cross(rotations, poses.rotations, axis=-2).sum(axis=-1)
        step = np.concatenate([shift, turn], axis=-1)
        joints = joints + np.einsum("pij,...pj->...pi", poses.inverse, step)
    left_mm = float(np.abs(shift).max())  # before the last step
    if not left_mm < SETTLED_MM:
        raise PoseNotSolved(
            f"an arm did not converge in {STEPS} steps", got=f"{left_mm:.2g} mm from its pose"
        )
    return joints, frames(joints)[0]
