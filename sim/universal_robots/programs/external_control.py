"""External Control of the vendor's C++ client: the robot dials the client, which streams set-points.

A message of the reverse interface is some int32, big-endian: limit for the next read (ms, 0: none), six
values, mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from math import ceil
from struct import Struct, pack
from typing import Final

from sim.universal_robots.kinematics import frame_of_pose
from sim.universal_robots.model import JOINTS
from sim.universal_robots.programs.control_settings import (
    LEAST_LAG_S,
    MILLISECONDS,
    REVERSE,
    SCRIPT_COMMANDS,
    TRAJECTORY,
    ControlSettings,
)
from sim.universal_robots.programs.external_trajectory import (
    ReceivedTrajectory,
    TrajectoryOrder,
    TrajectoryResult,
)
from sim.universal_robots.programs.motions import speedj, speedl, stopj
from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.programs.program import UrProgram
from sim.universal_robots.robot import Robot

DIAL_ORDER: Final = (TRAJECTORY, SCRIPT_COMMANDS, REVERSE)
MOST_MESSAGES: Final = 16  # of one connection in a cycle (U)
SPEED_ACCELERATION: Final = 40.0  # rad/s2 and m/s2, of its speed modes
TOOL_CONTACT_CANCELLED: Final = 1


class ControlMode(IntEnum):
    """Last number of a message of the reverse interface."""

    STOPPED = -2
    UNINITIALIZED = -1
    IDLE = 0
    SERVOJ = 1
    SPEEDJ = 2
    FORWARD = 3  # points come on the trajectory interface
    SPEEDL = 4
    POSE = 5
    FREEDRIVE = 6
    TOOL_IN_CONTACT = 7
    TORQUE = 8


class ControlCommand(IntEnum):
    """First number of a message of the script command interface, as far as it has an effect here."""

    SET_PAYLOAD = 1
    END_TOOL_CONTACT = 6
    SET_TCP_OFFSET = 10
    SET_TARGET_PAYLOAD = 12


def external_control(name: str, settings: ControlSettings) -> UrProgram:
    """Return the script as a program."""

    def steps(robot: Robot, program: UrProgram) -> Iterator[None]:
        yield from ExternalControl(robot, program, settings).steps()

    return UrProgram(name, steps)


class ExternalControl:
    """State of the running script: its connections, mode, set-point, and what runs beside its loop."""

    def __init__(self, robot: Robot, program: UrProgram, settings: ControlSettings) -> None:
        self._robot, self._program, self._settings = robot, program, settings
        self._links = {name: Outgoing() for name in DIAL_ORDER}
        program.links.extend(self._links.values())
        self._message = Struct(f">{settings.reverse_numbers}i")
        self._command = Struct(f">{settings.command_numbers}i")
        self._mode: int = ControlMode.UNINITIALIZED
        self._beside: Iterator[None] | None = None  # the motion of the mode
        self._goal: list[float] = robot.drives.actual
        self._is_new = False  # the goal, in this cycle
        self._ever_set = False
        self._speeds: Sequence[float] = ()
        self._limit_cycles = 0  # of the next read; 0: none
        self._silent_cycles = 0
        self._is_silent = False
        self._trajectory = ReceivedTrajectory(robot, self._links[TRAJECTORY], settings)
        self._lag_s = max(LEAST_LAG_S, settings.lookahead_s) + robot.parameters.servoj_lag_s

    def steps(self) -> Iterator[None]:
        """Dial, and obey messages until the client stops or falls silent."""
        for name in DIAL_ORDER:
            if name in self._settings.endpoints:
                yield from self._dial(name)
        while self._mode > ControlMode.STOPPED:
            yield from self._read_messages()
            if self._mode <= ControlMode.STOPPED:
                break
            self._take_commands()
            if self._beside is not None and next(self._beside, self) is self:
                self._beside = None
            yield
        yield from stopj(self._robot, self._settings.stop_rad_s2)
        for link in self._links.values():
            link.close()
        if not self._is_silent:
            yield from self._dial_after()

    def _dial(self, name: str) -> Iterator[None]:
        host, port = self._settings.endpoints[name]
        link = self._links[name]
        yield from link.dial(host, port, self._robot.cycle_s)
        if not link.is_open:
            # A popup blocks the program until somebody continues it.
            self._program.failure = f"{name}: no connection to {host}:{port}"
            while True:
                yield

    def _dial_after(self) -> Iterator[None]:
        """Open what a program opens behind the loop, which a silent client ends with the program."""
        for name, (host, port) in self._settings.endpoints.items():
            if name not in self._links:
                link = Outgoing()
                self._program.links.append(link)
                yield from link.dial(host, port, self._robot.cycle_s)

    # -- messages

    def _read_messages(self) -> Iterator[None]:
        """Obey what has arrived; without a message within the limit the mode becomes STOPPED."""
        link = self._links[REVERSE]
        self._silent_cycles += 1
        for _ in range(MOST_MESSAGES):
            message = link.take(self._message)
            if message is None:
                break
            self._silent_cycles = 0
            self._limit_cycles = ceil(message[0] / MILLISECONDS / self._robot.cycle_s)
            yield from self._obey(message[1:-1], message[-1])
            if self._mode <= ControlMode.STOPPED:
                return
        if not link.is_open or 0 < self._limit_cycles < self._silent_cycles:
            self._mode, self._is_silent = ControlMode.STOPPED, True

    def _obey(self, numbers: tuple[int, ...], mode: int) -> Iterator[None]:
        if mode != self._mode:
            yield from self._change_mode(mode)
        values = [number / self._settings.units for number in numbers[:JOINTS]]
        if mode == ControlMode.SERVOJ:
            self._set_goal(values)
        elif mode == ControlMode.POSE:
            joints = self._robot.joints_at(frame_of_pose(values), self._goal)
            if joints is None:
                self._program.failure = "get_inverse_kin: no solution"
                self._mode = ControlMode.STOPPED
            else:
                self._set_goal(joints)
        elif mode in (ControlMode.SPEEDJ, ControlMode.SPEEDL):
            self._speeds = values
        elif mode == ControlMode.FORWARD:
            yield from self._direct_trajectory(numbers[0], numbers[1])

    def _change_mode(self, mode: int) -> Iterator[None]:
        robot = self._robot
        if self._mode == ControlMode.FORWARD and self._trajectory.left:
            yield from self._cancel_trajectory()
        self._mode = mode
        if self._beside is not None:
            self._beside = None
            yield from self._stop()
        if mode in (ControlMode.SERVOJ, ControlMode.POSE):
            self._goal = robot.drives.actual
            self._beside = self._servo()
        elif mode == ControlMode.SPEEDJ:
            self._speeds, self._beside = [0.0] * JOINTS, self._speed(speedj)
        elif mode == ControlMode.SPEEDL:
            self._speeds, self._beside = [0.0] * JOINTS, self._speed(speedl)

    def _stop(self) -> Iterator[None]:
        return stopj(self._robot, self._settings.stop_rad_s2)

    def _direct_trajectory(self, order: int, count: int) -> Iterator[None]:
        trajectory = self._trajectory
        if order in (TrajectoryOrder.RECEIVE, TrajectoryOrder.STREAM_START):
            self._beside = None
            yield from trajectory.discard()
            trajectory.begin(count, streams=order == TrajectoryOrder.STREAM_START)
            self._beside = trajectory.run(self._settings.stop_rad_s2)
        elif order == TrajectoryOrder.STREAM_END:
            trajectory.end_stream(count)
        elif order == TrajectoryOrder.CANCEL:
            trajectory.end_stream(count)
            yield from self._cancel_trajectory()

    def _cancel_trajectory(self) -> Iterator[None]:
        self._beside = None
        yield from self._stop()
        yield from self._trajectory.discard()
        self._trajectory.report(TrajectoryResult.CANCELLED)

    def _take_commands(self) -> None:
        link = self._links[SCRIPT_COMMANDS]
        for _ in range(MOST_MESSAGES):
            message = link.take(self._command)
            if message is None:
                return
            values = [number / self._settings.units for number in message[1:]]
            if message[0] in (ControlCommand.SET_PAYLOAD, ControlCommand.SET_TARGET_PAYLOAD):
                self._robot.set_payload(values[0], values[1:4])
            elif message[0] == ControlCommand.SET_TCP_OFFSET:
                self._robot.set_tcp(values[:JOINTS])
            elif message[0] == ControlCommand.END_TOOL_CONTACT:
                link.send(pack(">i", TOOL_CONTACT_CANCELLED))

    # -- motions

    def _set_goal(self, joints_rad: list[float]) -> None:
        """Take a set-point, unless it is too far from the last and from the arm."""
        self._is_new = self._ever_set = True
        if self._is_near(self._goal, joints_rad) or self._is_near(self._robot.drives.actual, joints_rad):
            self._goal = joints_rad

    def _is_near(self, start_rad: Sequence[float], end_rad: Sequence[float]) -> bool:
        largest = self._settings.ignored_rad_s * self._robot.cycle_s
        return all(abs(b - a) <= largest for a, b in zip(start_rad, end_rad, strict=True))

    def _servo(self) -> Iterator[None]:
        """Follow the goal; without a new one it goes on with the speed of the target."""
        drives, cycle_s = self._robot.drives, self._robot.cycle_s
        while True:
            if not self._is_new and self._ever_set:
                speeds = drives.target_speed
                self._goal = [a + speed * cycle_s for a, speed in zip(self._goal, speeds, strict=True)]
            self._is_new = False
            if self._ever_set:
                drives.servo(self._goal, self._lag_s)
            yield

    def _speed(self, approach: Callable[[Robot, Sequence[float], float], None]) -> Iterator[None]:
        while True:
            approach(self._robot, self._speeds, SPEED_ACCELERATION)
            yield
