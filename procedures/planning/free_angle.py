"""Use the free angle of a trajectory: turn about its axis until everything is seen and reached well.

Turns are tried from the planned angle outwards. The first that keeps the wrist clear of its singularity is
taken; if none does, the clearest. The choice is a result, not a change of the plan: entry, target and axis
stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.planning.reach import branches_for, check_paths, drive
from procedures.planning.sight import StereoSight
from procedures.planning.visits import ArmSetting, PathCheck, Unmet, visits_of
from procedures.planning.wrist import WristState
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch

Array = NDArray[np.float64]

STEP_RAD = math.radians(10.0)
FURTHEST_RAD = math.radians(90.0)


@dataclass(frozen=True)
class TurnedPaths:
    """The paths with the trajectories as turned; `turns_rad` is how far each stands from the plan's angle."""

    check: PathCheck
    trajectories: tuple[Trajectory, ...]
    turns_rad: tuple[float, ...]


def turns_rad() -> Iterator[float]:
    """0, then outwards, alternating sides."""
    yield 0.0
    for step in range(1, round(FURTHEST_RAD / STEP_RAD) + 1):
        yield step * STEP_RAD
        yield -step * STEP_RAD


def choose_free_angles(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> TurnedPaths:
    """Find an angle for each trajectory in which all is seen and one branch drives all.

    Trajectories and fiducials (n, 3) are in CT mm. A turn with a good wrist (see `WristState.good`) comes
    before one that only passes. When there is none, `check` names what is unmet at the planned
    angles, or at the nearest ones that are seen.
    """
    fiducials = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    options = [_seen(setting, trajectory, fiducials, sight) for trajectory in trajectories]
    blind = [
        problem
        for trajectory, turns in zip(trajectories, options, strict=True)
        if not turns
        for problem in _hidden(setting, trajectory, fiducials, sight)
    ]
    own = (0.0,) * len(trajectories)
    if blind:
        return TurnedPaths(PathCheck(None, (), (), tuple(blind)), tuple(trajectories), own)
    nearest = tuple(turns[0] for turns in options)
    turned = tuple(_turned(one, turn) for one, turn in zip(trajectories, nearest, strict=True))
    for branch in branches_for(setting, visits_of(setting, turned, fiducials)):
        found = _in_branch(setting, trajectories, fiducials, options, branch)
        if found is not None:
            return found
    check = check_paths(setting, turned, fiducials)
    return (
        TurnedPaths(check, turned, nearest) if check.passed else TurnedPaths(check, tuple(trajectories), own)
    )


def _in_branch(
    setting: ArmSetting,
    trajectories: Sequence[Trajectory],
    fiducials_mm: Array,
    options: Sequence[Sequence[float]],
    branch: Branch,
) -> TurnedPaths | None:
    """The best turns that this branch drives, one trajectory after the other; None when it cannot."""
    ranked = [
        _ranked(setting, trajectory, fiducials_mm, turns, branch)
        for trajectory, turns in zip(trajectories, options, strict=True)
    ]
    chosen: list[float] = []
    for turns in ranked:
        first = next(turns, None)
        if first is None:
            return None
        chosen.append(first)
    while True:
        turned = tuple(_turned(one, turn) for one, turn in zip(trajectories, chosen, strict=True))
        check = drive(setting, visits_of(setting, turned, fiducials_mm), branch, turned)
        if check.passed:
            return TurnedPaths(check, turned, tuple(chosen))
        # Each passes alone, but here it is approached from elsewhere: whole turns of an axis may differ.
        failed = {problem.pose.partition("/")[0] for problem in check.unmet}
        for number, trajectory in enumerate(trajectories):
            if trajectory.identifier in failed:
                other = next(ranked[number], None)
                if other is None:
                    return None
                chosen[number] = other


def _ranked(
    setting: ArmSetting,
    trajectory: Trajectory,
    fiducials_mm: Array,
    turns: Sequence[float],
    branch: Branch,
) -> Iterator[float]:
    """The turns this branch drives: those with a good wrist from near to far, then the others, best first."""
    others: list[tuple[float, float]] = []
    for turn in turns:
        turned = (_turned(trajectory, turn),)
        check = drive(setting, visits_of(setting, turned, fiducials_mm), branch, turned, first_only=True)
        if not check.passed:
            continue
        wrist = WristState.of(setting.kinematics, check)
        if wrist.good:
            yield turn
        else:
            others.append((wrist.least_bend_rad, turn))
    for _, turn in sorted(others, key=lambda one: -one[0]):
        yield turn


def _seen(
    setting: ArmSetting, trajectory: Trajectory, fiducials_mm: Array, sight: StereoSight
) -> list[float]:
    return [
        turn for turn in turns_rad() if not _hidden(setting, _turned(trajectory, turn), fiducials_mm, sight)
    ]


def _hidden(
    setting: ArmSetting, trajectory: Trajectory, fiducials_mm: Array, sight: StereoSight
) -> tuple[Unmet, ...]:
    visits = visits_of(setting, (trajectory,), fiducials_mm)
    return sight.unmet(visits, setting.robot_from_ct.apply(fiducials_mm))


def _turned(trajectory: Trajectory, turn_rad: float) -> Trajectory:
    return replace(trajectory, free_angle_rad=trajectory.free_angle_rad + turn_rad)
