"""Alternative strategies for a trajectory that the case's own cannot serve."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from procedures.planning.path_check.free_angle import choose_free_angles
from procedures.planning.path_check.paths import drive
from procedures.planning.path_check.visits import ArmSetting, Axes, PathCheck
from procedures.planning.sight.stereo_head import StereoSight
from procedures.strategies.catalogue import CANDIDATES, BestOfEach, strategy_named
from procedures.strategies.strategy import OUTWARDS_RAD, Strategy
from procedures.strategies.trajectory import Trajectory

BY_ACCURACY = ("improved", "ocs", "jdms", "nos")  # on an uncalibrated arm


def alternatives(
    setting: ArmSetting,
    trajectory: Trajectory,
    fiducials_mm: ArrayLike,
    sight: StereoSight,
    tried: Collection[str] = (),
) -> tuple[Strategy, ...]:
    """Strategies with which this trajectory alone is visible, reachable and clear, best first.

    The trajectory and the fiducials (n, 3) are in CT mm. The case's own and those already tried are left out.
    """
    if not _target_reached(setting, trajectory):
        return ()
    known = {setting.strategy.name, *tried}
    if isinstance(setting.strategy, BestOfEach):
        known |= {one.name for one in CANDIDATES}
    candidates = [strategy_named(name) for name in BY_ACCURACY if name not in known]
    return tuple(
        one
        for one in candidates
        if choose_free_angles(replace(setting, strategy=one), (trajectory,), fiducials_mm, sight).check.passed
    )


def unreached(check: PathCheck, trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """The trajectories that a check does not reach, with the first reason for each.

    A failure that belongs to none of them, such as in a neutral orientation, applies to all.
    """
    reasons: dict[str, str] = {}
    for unmet in check.unmet:
        reasons.setdefault(unmet.pose.partition("/")[0], f"{unmet.pose}: {unmet.reason}")
    own = {one.identifier: reasons[one.identifier] for one in trajectories if one.identifier in reasons}
    if len(own) == len(reasons):
        return own
    shared = next(iter(reasons.values()))
    return {one.identifier: own.get(one.identifier, shared) for one in trajectories}


def advice(would: Mapping[str, Sequence[Strategy]]) -> str | None:
    """Which strategies would serve, by trajectory; None, for the usual advice, if none would."""
    reaching = [
        f"{name} by {' or '.join(one.name for one in others)}" for name, others in would.items() if others
    ]
    if not reaching:
        return None
    return (
        f"Choose another --strategy, which would reach {', '.join(reaching)}; or move the cart or the head."
    )


def _target_reached(setting: ArmSetting, trajectory: Trajectory) -> bool:
    """Whether the guide reaches the target at some angle; if not, no strategy serves it."""
    return any(
        drive(setting, target, (), branch, first_only=True).passed
        for branch in setting.kinematics.branches
        for turn in OUTWARDS_RAD
        for target in (Axes((), (trajectory,)).turned({trajectory.identifier: turn}),)
    )
