"""Looks of the stereo head at the skin, as a strategy: one set of poses for all targets, chosen elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Strategy
from procedures.strategies.trajectory import UP, Trajectory
from ronna_hw.frames import Transform

SKIN = "skin of the head"  # contains spaces, so no planned trajectory can have this name
LENGTH_MM = 100.0  # of the axis that stands for all looks; any length will do


@dataclass(frozen=True)
class SkinLooks(Strategy):
    """Strategy `surface`: the given poses ROBOT <- TOOL, with the tool centre on the skin."""

    poses: tuple[Transform, ...] = ()
    name: str = "surface"
    controls_approach: bool = False
    localizes_per_trajectory: bool = False

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return one axis that stands for all looks, or () without looks."""
        if not self.poses:
            return ()
        middle = np.mean([one.translation_mm for one in self.poses], axis=0)
        entry, target = robot_from_ct.inverse().apply([middle + LENGTH_MM * UP, middle]).tolist()
        return (Trajectory(SKIN, tuple(entry), tuple(target)),)

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return the poses, in the order of the scan."""
        return self.poses

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """Return all turns of a target, and none but zero of the looks: their poses are given."""
        return (0.0,) if along.identifier == SKIN else OUTWARDS_RAD
