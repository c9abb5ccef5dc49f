"""JDMS, joint displacement minimization strategy: the least joint motion from each fiducial to the target.

Every fiducial has its own orientation: the one whose joints differ least from those at the target while the
tool origin is at the fiducial. Joint and link errors are then nearly equal at both and cancel. The cost: the
orientations differ slightly, so a tool frame error does not cancel entirely.

The thesis states neither norm nor weights. We use the Euclidean norm of the six angles, and the free angle
that minimises its root mean square over the fiducials.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.arm_in_branch import ArmInBranch, Joints
from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.free_turns import OUTWARDS_RAD
from procedures.strategies.least_displacement import least_displacement
from procedures.strategies.target import target_pose
from procedures.strategies.trajectory import Trajectory
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform


@dataclass(frozen=True)
class JointDisplacementMinimization:
    """The strategy `jdms`."""

    name: str = "jdms"
    controls_approach: bool = True
    localizes_per_trajectory: bool = True

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """The trajectories."""
        return tuple(trajectories)

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """One pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, with joints nearest to those at the target.

        Raises ARM-001 to ARM-003 when the target is out of reach in this branch, STR-004 when no nearby
        joints reach a fiducial.
        """
        _, at_fiducials = joints_of(along, fiducials_mm, robot_from_ct, arm)
        return tuple(arm.stereo_pose(joints) for joints in at_fiducials)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """Least displacement first; turns with a pose out of reach in this branch are left out."""
        ranked = []
        for turn in OUTWARDS_RAD:
            turned = replace(along, free_angle_rad=along.free_angle_rad + turn)
            try:
                at_target, at_fiducials = joints_of(turned, fiducials_mm, robot_from_ct, arm)
            except (LimitError, NoNearbyJoints):
                continue
            ranked.append((sum(math.dist(at_target, one) ** 2 for one in at_fiducials), turn))
        return tuple(turn for _, turn in sorted(ranked, key=lambda one: one[0]))


def joints_of(
    along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
) -> tuple[Joints, tuple[Joints, ...]]:
    """Joints at the target and at each fiducial."""
    at_target = arm.guide_at(target_pose(along, robot_from_ct))
    points = robot_from_ct.apply(np.asarray(fiducials_mm, dtype=float).reshape(-1, 3))
    return at_target, tuple(
        least_displacement(arm.kinematics, arm.flange_from_stereo.translation_mm, at_target, point)
        for point in points
    )
