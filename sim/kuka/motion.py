"""Interpolator: generates one command per cycle for an EKI motion, then its acknowledgement.

It knows only the nominal arm; the true arm follows its encoders.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

import numpy as np

from ronna_hw.wire.kuka_eki import AckCode
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.pendant import PendantMessage, end_switch, near_singularity, too_fast
from sim.world.nominal_arm import RobotDescription
from sim.world.rigid import Matrix, rotation_from_vector
from sim.world.trapezoid import Trapezoid
from sim.world.true_arm import rotation_vector

Inverse = Callable[[Matrix, Sequence[float]], list[float] | None]


class Acknowledgement(NamedTuple):
    """Controller's answer to a request: a code and an explanatory text."""

    code: AckCode = AckCode.OK
    text: str = ""


DONE = Acknowledgement()


@dataclass
class EkiMotion:
    """A motion in progress, which calls `report` once with its outcome."""

    points: Iterator[list[float] | PendantMessage]
    report: Callable[[Acknowledgement], None]
    message: PendantMessage | None = field(default=None, init=False)

    def next_point(self) -> list[float] | None:
        """Return the axes (deg) for the next cycle, or None at the end or after an abort (see `message`)."""
        point = next(self.points, None)
        if isinstance(point, PendantMessage):
            self.message = point
            return None
        return point


def path_parameters(speed_1_s: float, acceleration_1_s2: float, cycle_s: float) -> Iterator[float]:
    """Yield the path parameter of a trapezoidal speed profile once per cycle, ending at 1."""
    profile = Trapezoid(1.0, speed_1_s, acceleration_1_s2)
    for number in range(1, max(1, round(profile.duration_s / cycle_s))):
        yield profile.share(number * cycle_s)
    yield 1.0


def point_to_point(
    arm: RobotDescription,
    start_deg: Sequence[float],
    goal_deg: Sequence[float],
    speed_share: float,
    acceleration_share: float,
    cycle_s: float,
    fastest_1_s: float = inf,
) -> Iterator[list[float] | PendantMessage]:
    """Yield the axes (deg) of a synchronous motion, given shares of the axis speed and acceleration limits.

    `fastest_1_s` limits the speed, in whole paths per second.
    """
    travels_deg = [goal - start for goal, start in zip(goal_deg, start_deg, strict=True)]
    speeds, accelerations = [], []
    for travel_deg, joint in zip(travels_deg, arm.joints, strict=True):
        if travel_deg:
            speeds.append(joint.full_speed_deg_s * speed_share / abs(travel_deg))
            accelerations.append(joint.acceleration_deg_s2 * acceleration_share / abs(travel_deg))
    if not speeds:
        return
    for share in path_parameters(min(fastest_1_s, *speeds), min(accelerations), cycle_s):
        if share == 1.0:
            yield list(goal_deg)
        else:
            yield [
                start + share * travel_deg for start, travel_deg in zip(start_deg, travels_deg, strict=True)
            ]


def pose_on_line(start: Matrix, goal: Matrix, turn: Matrix, share: float) -> Matrix:
    """Return the pose (4, 4) at a fraction of a straight line that turns by rotation vector `turn` (rad)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_vector(share * turn) @ start[:3, :3]
    pose[:3, 3] = start[:3, 3] + share * (goal[:3, 3] - start[:3, 3])
    return pose


def line(
    arm: RobotDescription,
    start: Matrix,
    goal: Matrix,
    start_deg: Sequence[float],
    inverse: Inverse,
    speed_mm_s: float,
    parameters: ControllerParameters,
    cycle_s: float,
) -> Iterator[list[float] | PendantMessage]:
    """Yield the axes (deg) of a straight tool motion to a pose (4, 4) in $ROBROOT."""
    turn = rotation_vector(goal[:3, :3] @ start[:3, :3].T)
    length_mm = float(np.linalg.norm(goal[:3, 3] - start[:3, 3]))
    angle_rad = float(np.linalg.norm(turn))
    acceleration_mm_s2 = parameters.line_acceleration_mm_s2
    speeds, accelerations = [], []
    if length_mm:
        speeds.append(speed_mm_s / length_mm)
        accelerations.append(acceleration_mm_s2 / length_mm)
    if angle_rad:
        speeds.append(parameters.line_turn_rad_s / angle_rad)
        # The rotation reaches its speed in the same time as the translation.
        accelerations.append(parameters.line_turn_rad_s * acceleration_mm_s2 / speed_mm_s / angle_rad)
    if not speeds:
        return
    before = list(start_deg)
    for share in path_parameters(min(speeds), min(accelerations), cycle_s):
        axes = inverse(pose_on_line(start, goal, turn, share), before)
        if axes is None:
            yield near_singularity()
            return
        message = _check_limits(arm, axes, before, parameters, cycle_s)
        if message is not None:
            yield message
            return
        before = axes
        yield axes


def _check_limits(
    arm: RobotDescription,
    axes_deg: list[float],
    before_deg: list[float],
    parameters: ControllerParameters,
    cycle_s: float,
) -> PendantMessage | None:
    for joint, now, before in zip(arm.joints, axes_deg, before_deg, strict=True):
        if not joint.lower_deg <= now <= joint.upper_deg:
            return end_switch(parameters.end_switch_message, joint.name, now)
        speed = (now - before) / cycle_s
        if abs(speed) > joint.full_speed_deg_s:
            return too_fast(joint.name, speed, joint.full_speed_deg_s)
    return None
