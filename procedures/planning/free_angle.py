"""Use the angle that a trajectory leaves free: turn about its axis until everything is seen and reached.

The plan's own angle is tried first, then others from near to far. What is chosen is a result, not a
change of the plan: entry, target and axis stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.reach import ArmSetting, PathCheck, Unmet, check_paths, visits_of
from procedures.planning.sight import StereoSight
from procedures.strategies.trajectory import Trajectory

STEP_RAD = math.radians(10.0)
FURTHEST_RAD = math.radians(90.0)


@dataclass(frozen=True)
class TurnedPaths:
    """The paths with the trajectories as turned; `turns_rad` is how far each stands from the plan's angle."""

    check: PathCheck
    trajectories: tuple[Trajectory, ...]
    turns_rad: tuple[float, ...]


def turns_rad() -> Iterator[float]:
    """0, then away from it on both sides in turn."""
    yield 0.0
    for step in range(1, round(FURTHEST_RAD / STEP_RAD) + 1):
        yield step * STEP_RAD
        yield -step * STEP_RAD


def choose_free_angles(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> TurnedPaths:
    """Find an angle for each trajectory in which all is seen and one branch drives all.

    Trajectories and fiducials (n, 3) are in CT mm. When there is none, the answer's `check` names what is
    unmet at the plan's own angles.
    """
    fiducials = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    options = [list(_seen(setting, trajectory, fiducials, sight)) for trajectory in trajectories]
    blind = [
        problem
        for trajectory, turns in zip(trajectories, options, strict=True)
        if not turns
        for problem in _hidden(setting, trajectory, fiducials, sight)
    ]
    if blind:
        return TurnedPaths(
            PathCheck(None, (), (), tuple(blind)), tuple(trajectories), (0.0,) * len(trajectories)
        )
    chosen = [0] * len(trajectories)
    first: PathCheck | None = None
    while True:
        turns = tuple(turns[index] for turns, index in zip(options, chosen, strict=True))
        turned = tuple(_turned(one, turn) for one, turn in zip(trajectories, turns, strict=True))
        check = check_paths(setting, turned, fiducials)
        if check.passed:
            return TurnedPaths(check, turned, turns)
        first = first or check
        failed = {problem.pose.partition("/")[0] for problem in check.unmet}
        for number, trajectory in enumerate(trajectories):
            if trajectory.identifier in failed:
                chosen[number] += 1
                if chosen[number] == len(options[number]):
                    return TurnedPaths(first, tuple(trajectories), (0.0,) * len(trajectories))


def _seen(
    setting: ArmSetting, trajectory: Trajectory, fiducials_mm: np.ndarray, sight: StereoSight
) -> Iterator[float]:
    for turn in turns_rad():
        if not _hidden(setting, _turned(trajectory, turn), fiducials_mm, sight):
            yield turn


def _hidden(
    setting: ArmSetting, trajectory: Trajectory, fiducials_mm: np.ndarray, sight: StereoSight
) -> tuple[Unmet, ...]:
    visits = visits_of(setting, (trajectory,), fiducials_mm)
    return sight.unmet(visits, setting.robot_from_ct.apply(fiducials_mm))


def _turned(trajectory: Trajectory, turn_rad: float) -> Trajectory:
    return replace(trajectory, free_angle_rad=trajectory.free_angle_rad + turn_rad)
