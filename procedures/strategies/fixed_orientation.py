"""Strategies that localize all fiducials in one orientation: the target's (OCS), or straight down (NOS).

OCS: a constant tool frame error shifts all localizations and the target alike and cancels. The cost: the
localizations are repeated for every trajectory, and all must be reachable in its orientation. The thesis
leaves open from which side each joint arrives, and mentions the backlash that remains. `ocs` controls it;
without that control it is the thesis' own (`thesis-ocs`).

NOS: one set of localizations and one registration serve all targets. The cost: a tool frame error rotates
with the tool between the neutral orientation and a target's, and does not cancel. The thesis does not state
its neutral angles. We use tool z down and tool x radially away from the robot's base, as at free angle 0 of
every trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.names import DEFAULT_STRATEGY
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Strategy
from procedures.strategies.trajectory import UP, Trajectory, poses_along, require_frames
from ronna_hw.frames import Frame, Transform

NEUTRAL = "neutral orientation"  # contains a space, so no planned trajectory can have this name
LENGTH_MM = 100.0  # of the axis that represents the orientation; any length will do


@dataclass(frozen=True)
class OrientationCorrection(Strategy):
    """Orientation correction strategy: `ocs`, and `thesis-ocs`, which does not control the approach."""

    name: str = DEFAULT_STRATEGY
    controls_approach: bool = True
    localizes_per_trajectory: bool = True

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return one pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, all oriented along the axis."""
        return poses_along(along, fiducials_mm, robot_from_ct)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """Return all turns in rad by increasing distance from the free angle. All are equally suitable."""
        return OUTWARDS_RAD


@dataclass(frozen=True)
class NeutralOrientation(OrientationCorrection):
    """Neutral orientation strategy, `nos`: like `ocs`, but along one axis for all targets."""

    name: str = "nos"
    controls_approach: bool = False
    localizes_per_trajectory: bool = False

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return the vertical through the centroid of the fiducials (n, 3) in CT mm, or () without fiducials.

        Raises FRM-001 on other frames.
        """
        require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
        points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
        if not len(points):
            return ()
        middle = robot_from_ct.apply(points.mean(axis=0))
        entry, target = robot_from_ct.inverse().apply([middle + LENGTH_MM * UP, middle]).tolist()
        return (Trajectory(NEUTRAL, tuple(entry), tuple(target)),)


@dataclass(frozen=True)
class LearningStrategy(OrientationCorrection):
    """Strategy `learning`: the looks of a case estimate the arm's errors and the registration together.

    Free angles are those of `ocs`. Its poses are candidates beside those of other strategies, see
    `procedures.planning.learning_looks`.
    """

    name: str = "learning"
    localizes_per_trajectory: bool = False
    learns_arm: bool = True
