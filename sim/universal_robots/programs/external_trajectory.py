"""Trajectory interface of External Control: points that wait in a connection, executed one after the other.

A point is 21 int32: six values, twelve that depend on its type, time, blend radius or kind of spline, type.
Blend radii are ignored: the arm rests at every point that is not of a spline (U).
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from enum import IntEnum
from math import dist, hypot, sqrt
from struct import Struct, pack
from typing import Final

from sim.universal_robots.kinematics import compose, frame_of_pose, inverted, rotation_vector
from sim.universal_robots.model import JOINTS, LARGEST_ACCELERATION_RAD_S2
from sim.universal_robots.programs.arc import movec
from sim.universal_robots.programs.control_settings import ControlSettings
from sim.universal_robots.programs.joint_spline import cubic, follow_spline, quintic
from sim.universal_robots.programs.motions import SMALLEST_PATH, TURN_PER_LENGTH, movej, movel, stopj
from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.robot import Robot

POINT: Final = Struct(">21i")
SPEED_PLACE, ACCELERATION_PLACE, MODE_PLACE = 12, 13, 14
TIME_PLACE, KIND_PLACE, TYPE_PLACE = 18, 19, 20
FIRST_WAIT_S: Final = 0.5  # for a point while the arm rests; in motion it waits one cycle
UNKNOWN_COUNT: Final = 2**31 - 1  # points of a stream whose end is not known
DISCARDED_A_CYCLE: Final = 10  # points
ALREADY_THERE_RAD: Final = 0.01  # from a first point without time, which is passed over


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
    MOVEC = 3
    OPTIMOVEJ = 4
    OPTIMOVEL = 5
    MOVEJ_POSE = 6
    MOVEL_JOINT = 7
    MOVEP_JOINT = 8
    MOVEC_JOINT = 9
    MOVEC_JOINT_BY_POSE = 10
    MOVEC_BY_JOINT = 11
    OPTIMOVEJ_POSE = 12
    OPTIMOVEL_JOINT = 13
    SPLINE = 51


CUBIC, QUINTIC = 1, 2
TO_JOINTS: Final = frozenset({PointType.MOVEJ, PointType.OPTIMOVEJ})
TO_JOINTS_OF_POSE: Final = frozenset({PointType.MOVEJ_POSE, PointType.OPTIMOVEJ_POSE})
LINE_TO_JOINTS: Final = frozenset({PointType.MOVEL_JOINT, PointType.MOVEP_JOINT, PointType.OPTIMOVEL_JOINT})
LINES: Final = LINE_TO_JOINTS | {PointType.MOVEL, PointType.MOVEP, PointType.OPTIMOVEL}
ARC_TO_JOINTS: Final = frozenset({PointType.MOVEC_JOINT, PointType.MOVEC_JOINT_BY_POSE})
ARC_BY_JOINTS: Final = frozenset({PointType.MOVEC_JOINT, PointType.MOVEC_BY_JOINT})
ARCS: Final = ARC_TO_JOINTS | ARC_BY_JOINTS | {PointType.MOVEC}


class ReceivedTrajectory:
    """Points that were announced, and the motion through them."""

    def __init__(self, robot: Robot, link: Outgoing, settings: ControlSettings) -> None:
        self._robot, self._link, self._settings = robot, link, settings
        self.left = 0  # points announced and not yet read
        self._streams = False
        self._is_moving = False  # between two points of a spline
        self._speed: Sequence[float] = (0.0,) * JOINTS  # at the end of the last point of a spline
        self._acceleration: Sequence[float] = (0.0,) * JOINTS

    def begin(self, count: int, *, streams: bool) -> None:
        """Expect so many points, or a stream of them until its end is told."""
        self._streams = streams
        self.left = UNKNOWN_COUNT if streams else max(0, count)

    def end_stream(self, count: int) -> None:
        """Expect no more than so many points since the stream began."""
        if self._streams:
            self.left = max(0, count - (UNKNOWN_COUNT - self.left))
            self._streams = False

    def discard(self) -> Iterator[None]:
        """Read the points that are left, until one does not come in time."""
        self._is_moving = False
        read = 0
        while self.left > 0 and (yield from self._await_point()):
            self.left -= 1
            read += 1
            if read % DISCARDED_A_CYCLE == 0:
                yield
        self.left, self._streams = 0, False

    def report(self, result: TrajectoryResult) -> None:
        """Tell the client how its trajectory ended."""
        if result is not TrajectoryResult.CANCELLED or self._settings.reports_cancelled:
            self._link.send(pack(">i", result))

    def run(self, stop_rad_s2: float) -> Iterator[None]:
        """Go through the points, come to rest, and report the result."""
        yield from stopj(self._robot, stop_rad_s2)
        result = TrajectoryResult.SUCCESS
        self._is_moving = False
        self._speed = self._acceleration = (0.0,) * JOINTS
        is_first = True
        while self.left > 0 and result is TrajectoryResult.SUCCESS:
            point = yield from self._await_point()
            if point is None:
                if self.left > 0:
                    result = TrajectoryResult.FAILURE
                break
            self.left -= 1
            is_spline = point[TYPE_PLACE] == PointType.SPLINE
            motion = self._spline(point, is_first=is_first) if is_spline else self._motion(point)
            is_first = False
            if motion is not None:
                served = self._robot.drives.served
                yield from motion
                if self._robot.drives.served == served:  # no motion: a flood of such points takes its cycles
                    yield
            elif is_spline and point[KIND_PLACE] in (CUBIC, QUINTIC):
                result = TrajectoryResult.CANCELLED
            else:
                result = TrajectoryResult.FAILURE
        yield from stopj(self._robot, stop_rad_s2)
        self.report(result)

    def _await_point(self) -> Generator[None, None, tuple[int, ...] | None]:
        """Return the next point, or None if it does not come in time."""
        cycles = 1 if self._is_moving else round(FIRST_WAIT_S / self._robot.cycle_s)
        point = self._link.take(POINT)
        while point is None and self.left > 0 and cycles > 0:
            if self._is_moving:
                self._robot.drives.coast()
            yield
            cycles -= 1
            point = self._link.take(POINT)
        return point

    def _motion(self, point: tuple[int, ...]) -> Iterator[None] | None:
        """Return the motion to a point, or None if it has none."""
        robot, target = self._robot, self._robot.drives.target
        values = [number / self._settings.units for number in point[:TIME_PLACE]]
        goal, second = values[:JOINTS], values[JOINTS : 2 * JOINTS]
        time_s, kind = point[TIME_PLACE] / self._settings.time_units, point[TYPE_PLACE]
        speed, acceleration = values[SPEED_PLACE], values[ACCELERATION_PLACE]
        self._speed = self._acceleration = (0.0,) * JOINTS
        if kind in TO_JOINTS_OF_POSE:
            joints = robot.joints_at(frame_of_pose(goal), second if point[MODE_PLACE] else target)
            if joints is None:
                return None
            goal = joints
        if kind in TO_JOINTS or kind in TO_JOINTS_OF_POSE:
            length = max(abs(b - a) for a, b in zip(target, goal, strict=True))
            return movej(robot, goal, *_profile(length, speed, acceleration, time_s))
        if kind in ARC_TO_JOINTS or kind in LINE_TO_JOINTS:
            goal = robot.tool_pose(goal)
        if kind in ARCS:
            via = robot.tool_pose(second) if kind in ARC_BY_JOINTS else second
            return movec(robot, via, goal, speed, acceleration, keeps_turn=bool(point[MODE_PLACE]))
        if kind not in LINES:
            return None
        start, end = robot.tool_frame(target), frame_of_pose(goal)
        way = hypot(end.x - start.x, end.y - start.y, end.z - start.z)
        turn = hypot(*rotation_vector(compose(end, inverted(start))))
        length = max(way, turn * TURN_PER_LENGTH)
        used = _profile(length, speed, acceleration, time_s)
        return movel(robot, goal, *used, waits_for_joints=time_s > 0.0)

    def _spline(self, point: tuple[int, ...], *, is_first: bool) -> Iterator[None] | None:
        """Return a motion with these speeds, and accelerations if quintic, at its end; None if impossible."""
        start, kind = self._robot.drives.target, point[KIND_PLACE]
        values = [number / self._settings.units for number in point[:TIME_PLACE]]
        time_s = point[TIME_PLACE] / self._settings.time_units
        goal, speed, acceleration = (values[n : n + JOINTS] for n in range(0, TIME_PLACE, JOINTS))
        if is_first and time_s == 0.0 and dist(start, goal) < ALREADY_THERE_RAD:
            self._report_time(0.0)
            return iter(())
        farthest = max(abs(b - a) for a, b in zip(start, goal, strict=True))
        if kind not in (CUBIC, QUINTIC) or time_s <= 0.0 or farthest > self._settings.ignored_rad_s * time_s:
            return None
        if kind == QUINTIC:
            starts = zip(start, self._speed, self._acceleration, strict=True)
            ends = zip(goal, speed, acceleration, strict=True)
            joints = [quintic(a, b, time_s) for a, b in zip(starts, ends, strict=True)]
        else:
            acceleration = [0.0] * JOINTS
            slopes = zip(zip(start, self._speed, strict=True), zip(goal, speed, strict=True), strict=True)
            joints = [cubic(a, b, time_s) for a, b in slopes]
        self._speed, self._acceleration = speed, acceleration
        is_last = self.left == 0
        self._is_moving = not is_last
        return follow_spline(self._robot, joints, time_s, is_last=is_last, report=self._report_time)

    def _report_time(self, time_s: float) -> None:
        if self._settings.time_output is not None:
            self._robot.write_doubles(self._settings.time_output, [time_s])


def _profile(length: float, speed: float, acceleration: float, time_s: float) -> tuple[float, float]:
    """Return speed and acceleration of a motion; a time replaces the speed."""
    if time_s <= 0.0 or length < SMALLEST_PATH:
        return speed, acceleration
    least = 4.0 * length / time_s**2  # accelerates for one half and brakes for the other
    used = min(max(acceleration, least), LARGEST_ACCELERATION_RAD_S2)
    return (used * time_s - sqrt(max(0.0, (used * time_s) ** 2 - 4.0 * used * length))) / 2.0, used
