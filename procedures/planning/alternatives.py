"""Which other strategies would serve a trajectory that the one of the case does not."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from numpy.typing import ArrayLike

from procedures.planning.free_angle import choose_free_angles
from procedures.planning.reach import drive
from procedures.planning.sight import StereoSight
from procedures.planning.visits import ArmSetting, Axes
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.free_turns import OUTWARDS_RAD
from procedures.strategies.strategy import Strategy
from procedures.strategies.trajectory import Trajectory

BY_ACCURACY = ("improved", "ocs", "jdms", "nos")  # on an arm that is not calibrated


def alternatives(
    setting: ArmSetting,
    trajectory: Trajectory,
    fiducials_mm: ArrayLike,
    sight: StereoSight,
    tried: Collection[str],
) -> tuple[Strategy, ...]:
    """Strategies not yet tried by which this trajectory alone is seen, reached and clear, the best first.

    The trajectory and the fiducials (n, 3) are in CT mm.
    """
    if not _target_reached(setting, trajectory):
        return ()
    candidates = [strategy_named(name) for name in BY_ACCURACY if name not in tried]
    return tuple(
        one
        for one in candidates
        if choose_free_angles(replace(setting, strategy=one), (trajectory,), fiducials_mm, sight).check.passed
    )


def _target_reached(setting: ArmSetting, trajectory: Trajectory) -> bool:
    """Whether the guide reaches the target at some angle; if not, no strategy serves it."""
    return any(
        drive(setting, target, (), branch, first_only=True).passed
        for branch in setting.kinematics.branches
        for turn in OUTWARDS_RAD
        for target in (Axes((), (trajectory,)).turned({trajectory.identifier: turn}),)
    )
