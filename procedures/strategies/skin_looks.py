"""Looks of the stereo head at the skin in given poses: the axis of all, and the strategy without spheres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.names import SCAN_OF_SKIN
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Strategy
from procedures.strategies.trajectory import UP, Trajectory
from ronna_hw.frames import Transform

SKIN = "skin of the head"  # contains spaces, so no planned trajectory can have this name
LENGTH_MM = 100.0  # of the axis that stands for all looks; any length will do


def skin_axis(looks: Sequence[Transform], robot_from_ct: Transform) -> Trajectory:
    """Return the axis that stands for looks ROBOT <- TOOL at the skin, in the CT."""
    middle = np.mean([one.translation_mm for one in looks], axis=0)
    entry, target = robot_from_ct.inverse().apply([middle + LENGTH_MM * UP, middle]).tolist()
    return Trajectory(SKIN, tuple(entry), tuple(target))


@dataclass(frozen=True)
class SkinLooks(Strategy):
    """Strategy `surface`: there are no spheres, and the looks at the skin serve all targets."""

    name: str = SCAN_OF_SKIN
    controls_approach: bool = False
    localizes_per_trajectory: bool = False

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return no axis for spheres."""
        return ()

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return no pose over spheres."""
        return ()

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """Return all turns of a target."""
        return OUTWARDS_RAD
