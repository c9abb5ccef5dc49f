"""Trajectory interface of External Control: points that wait in a connection, executed one after the other.

A point is 21 int32: six values, twelve that depend on its type, time, blend radius or kind of spline, type.
Blend radii are ignored: the arm rests at every point that is not of a spline (U).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum
from math import hypot, sqrt
from struct import Struct, pack
from typing import Final

from sim.universal_robots.kinematics import compose, frame_of_pose, inverted, rotation_vector
from sim.universal_robots.model import JOINTS, LARGEST_ACCELERATION_RAD_S2
from sim.universal_robots.programs.motions import SMALLEST_PATH, TURN_PER_LENGTH, movej, movel, stopj
from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.robot import Robot

POINT: Final = Struct(">21i")
SPEED_PLACE, ACCELERATION_PLACE, NEAR_PLACE = 12, 13, 14
TIME_PLACE, KIND_PLACE, TYPE_PLACE = 18, 19, 20
FIRST_WAIT_S: Final = 0.5  # for a point while the arm rests; in motion it waits one cycle
UNKNOWN_COUNT: Final = 2**31 - 1  # points of a stream whose end is not known


class TrajectoryOrder(IntEnum):
    """First number of a reverse message in mode FORWARD."""

    CANCEL = -1
    RECEIVE = 1
    STREAM_START = 2
    STREAM_END = 3


class TrajectoryResult(IntEnum):
    """Answer on the trajectory interface."""

    SUCCESS = 0
    CANCELLED = 1
    FAILURE = 2


class PointType(IntEnum):
    """Type of a point, as far as it is simulated."""

    MOVEJ = 0
    MOVEL = 1
    MOVEP = 2
    OPTIMOVEJ = 4
    OPTIMOVEL = 5
    MOVEJ_POSE = 6
    MOVEL_JOINT = 7
    MOVEP_JOINT = 8
    OPTIMOVEJ_POSE = 12
    OPTIMOVEL_JOINT = 13
    SPLINE = 51


CUBIC, QUINTIC = 1, 2
TO_JOINTS: Final = frozenset({PointType.MOVEJ, PointType.OPTIMOVEJ})
TO_JOINTS_OF_POSE: Final = frozenset({PointType.MOVEJ_POSE, PointType.OPTIMOVEJ_POSE})
LINE_TO_POSE: Final = frozenset({PointType.MOVEL, PointType.MOVEP, PointType.OPTIMOVEL})
LINE_TO_JOINTS: Final = frozenset({PointType.MOVEL_JOINT, PointType.MOVEP_JOINT, PointType.OPTIMOVEL_JOINT})


class ReceivedTrajectory:
    """Points that were announced, and the motion through them."""

    def __init__(self, robot: Robot, link: Outgoing, units: float, time_units: float) -> None:
        self._robot, self._link = robot, link
        self._units, self._time_units = units, time_units
        self._left = 0  # points announced and not yet read
        self._streams = False
        self._speed: Sequence[float] = (0.0,) * JOINTS  # at the end of the last point of a spline
        self._acceleration: Sequence[float] = (0.0,) * JOINTS
        self.is_cancelled = False

    def obey(self, order: int, count: int) -> bool:
        """Carry out an order; returns whether a new trajectory begins."""
        self.is_cancelled = False
        if order in (TrajectoryOrder.RECEIVE, TrajectoryOrder.STREAM_START):
            self._streams = order == TrajectoryOrder.STREAM_START
            self._left = UNKNOWN_COUNT if self._streams else max(0, count)
            return True
        if self._streams and order in (TrajectoryOrder.STREAM_END, TrajectoryOrder.CANCEL):
            self._left = max(0, count - (UNKNOWN_COUNT - self._left))
            self._streams = False
        if order == TrajectoryOrder.CANCEL:
            self.cancel()
            self.is_cancelled = True
        return False

    def cancel(self) -> bool:
        """Discard the points that have arrived; returns whether some were left."""
        had_points = self._left > 0
        while self._left > 0 and self._link.take(POINT) is not None:
            self._left -= 1
        self._left, self._streams = 0, False
        return had_points

    def report_cancelled(self) -> None:
        """Tell the client that its trajectory did not end."""
        self._link.send(pack(">i", TrajectoryResult.CANCELLED))

    def run(self, stop_rad_s2: float) -> Iterator[None]:
        """Go through the points, come to rest, and report the result."""
        result = TrajectoryResult.SUCCESS
        self._speed = self._acceleration = (0.0,) * JOINTS
        while self._left > 0 and result is TrajectoryResult.SUCCESS:
            moving = any(self._speed)
            cycles = 1 if moving else round(FIRST_WAIT_S / self._robot.cycle_s)
            point = self._link.take(POINT)
            while point is None and self._left > 0 and cycles > 0:
                if moving:
                    self._robot.drives.coast()
                yield
                cycles -= 1
                point = self._link.take(POINT)
            if point is None:
                if self._left > 0:
                    result = TrajectoryResult.FAILURE
                break
            self._left -= 1
            motion = self._motion(point)
            if motion is None:
                result = (
                    TrajectoryResult.CANCELLED
                    if point[TYPE_PLACE] == PointType.SPLINE
                    else TrajectoryResult.FAILURE
                )
            else:
                yield from motion
        if result is not TrajectoryResult.SUCCESS:
            self.cancel()
        yield from stopj(self._robot, stop_rad_s2)
        self._link.send(pack(">i", result))

    def _motion(self, point: tuple[int, ...]) -> Iterator[None] | None:
        """Return the motion to a point, or None if it has none."""
        robot, target = self._robot, self._robot.drives.target
        values = [number / self._units for number in point[:TIME_PLACE]]
        goal, time_s, kind = values[:JOINTS], point[TIME_PLACE] / self._time_units, point[TYPE_PLACE]
        speed, acceleration = values[SPEED_PLACE], values[ACCELERATION_PLACE]
        if kind == PointType.SPLINE:
            return self._spline(values, time_s, point[KIND_PLACE])
        self._speed = self._acceleration = (0.0,) * JOINTS
        if kind in TO_JOINTS_OF_POSE:
            near = values[JOINTS : 2 * JOINTS] if point[NEAR_PLACE] else target
            joints = robot.joints_at(frame_of_pose(goal), near)
            if joints is None:
                return None
            goal = joints
        if kind in TO_JOINTS or kind in TO_JOINTS_OF_POSE:
            length = max(abs(b - a) for a, b in zip(target, goal, strict=True))
            return movej(robot, goal, *_profile(length, speed, acceleration, time_s))
        if kind in LINE_TO_JOINTS:
            goal = robot.tool_pose(goal)
        elif kind not in LINE_TO_POSE:
            return None
        start, end = robot.tool_frame(target), frame_of_pose(goal)
        way = hypot(end.x - start.x, end.y - start.y, end.z - start.z)
        turn = hypot(*rotation_vector(compose(end, inverted(start))))
        length = max(way, turn * TURN_PER_LENGTH)
        return movel(robot, goal, *_profile(length, speed, acceleration, time_s))

    def _spline(self, values: list[float], time_s: float, kind: int) -> Iterator[None] | None:
        """Return a motion with these speeds, and accelerations if quintic, at its end."""
        start, goal = self._robot.drives.target, values[:JOINTS]
        if time_s <= 0.0 or kind not in (CUBIC, QUINTIC):
            return None
        ends = (self._speed, values[JOINTS : 2 * JOINTS])
        accelerations = (self._acceleration, values[2 * JOINTS : 3 * JOINTS]) if kind == QUINTIC else None
        self._speed = ends[1]
        self._acceleration = accelerations[1] if accelerations else (0.0,) * JOINTS
        coefficients = [
            quintic(
                (start[n], ends[0][n], accelerations[0][n]),
                (goal[n], ends[1][n], accelerations[1][n]),
                time_s,
            )
            if accelerations
            else cubic((start[n], ends[0][n]), (goal[n], ends[1][n]), time_s)
            for n in range(JOINTS)
        ]
        return self._follow(coefficients, goal, time_s)

    def _follow(
        self, coefficients: list[tuple[float, ...]], goal: list[float], time_s: float
    ) -> Iterator[None]:
        robot, passed_s = self._robot, 0.0
        while passed_s < time_s:
            passed_s += robot.cycle_s * robot.speed_fraction
            if passed_s >= time_s:
                robot.drives.place(goal)
            else:
                robot.drives.place([_evaluate(one, passed_s) for one in coefficients])
            yield


def cubic(start: tuple[float, float], end: tuple[float, float], time_s: float) -> tuple[float, ...]:
    """Return the coefficients, lowest first, of the cubic with these angles and speeds at its ends."""
    (a, va), (b, vb) = start, end
    way = (b - a) / time_s
    return a, va, (3.0 * way - 2.0 * va - vb) / time_s, (va + vb - 2.0 * way) / time_s**2


def quintic(
    start: tuple[float, float, float], end: tuple[float, float, float], time_s: float
) -> tuple[float, ...]:
    """Return the coefficients of the quintic with these angles, speeds, accelerations at its ends."""
    (a, va, aa), (b, vb, ab) = start, end
    # What remains at the end of the parabola that the start gives.
    angle = (b - a - va * time_s - aa * time_s**2 / 2.0) / time_s**3
    speed = (vb - va - aa * time_s) / time_s**2
    acceleration = (ab - aa) / time_s
    return (
        a,
        va,
        aa / 2.0,
        10.0 * angle - 4.0 * speed + acceleration / 2.0,
        (-15.0 * angle + 7.0 * speed - acceleration) / time_s,
        (6.0 * angle - 3.0 * speed + acceleration / 2.0) / time_s**2,
    )


def _evaluate(coefficients: tuple[float, ...], time_s: float) -> float:
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * time_s + coefficient
    return value


def _profile(length: float, speed: float, acceleration: float, time_s: float) -> tuple[float, float]:
    """Return speed and acceleration of a motion; a time replaces the speed."""
    if time_s <= 0.0 or length < SMALLEST_PATH:
        return speed, acceleration
    least = 4.0 * length / time_s**2  # accelerates for one half and brakes for the other
    used = min(max(acceleration, least), max(least, LARGEST_ACCELERATION_RAD_S2))
    return (used * time_s - sqrt(max(0.0, (used * time_s) ** 2 - 4.0 * used * length))) / 2.0, used
