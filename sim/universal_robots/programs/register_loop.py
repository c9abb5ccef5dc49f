"""Register loop of the script that ur_rtde sends: commands in registers, one after the other.

Each command is an integer in input 0; output 0 says 1 when ready and 2 when done. The script's text, which
differs with the version of controller and client, is not interpreted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from sim.universal_robots.kinematics import compose, frame_of_pose, inverted, pose_of_frame
from sim.universal_robots.model import JOINT_RANGE_RAD, JOINTS
from sim.universal_robots.programs.motions import movej, movel, speedj, speedl, stopj
from sim.universal_robots.programs.program import UrProgram, Watchdog
from sim.universal_robots.robot import COMMANDED_STOP, Robot
from sim.universal_robots.variables import INPUT_INTS, PLACES

READY, DONE = 1, 2
NO_COMMAND, END_COMMAND = 0, 255
# Repeated for as long as they stand in the register: force mode, speedJ and L, servoJ and C, and look-ups.
CONTINUOUS: Final = frozenset({6, 9, 10, 11, 12, 24, 25, 26, 27, 38, 58, *range(66, 72)})
PROGRESS_RUNNING = 1 << 15
PROGRESS_WRITES, PROGRESS_OPERATION = 16, 24  # bits from where each counter begins
COUNTER_LIMIT = 128
_TORQUES = PLACES["target_moment"]

Handler = Callable[["RegisterLoop"], Iterator[None] | None]
Approach = Callable[[Robot, Sequence[float], float], None]  # of a speed, by a cycle


class RegisterLoop:
    """State of the script: what runs beside the loop, and the progress that it reports."""

    def __init__(self, robot: Robot, program: UrProgram, first_register: int) -> None:
        self.robot = robot
        self.program = program
        self.first = first_register
        self.beside: Iterator[None] | None = None  # a thread of the script
        self.servo_goal: list[float] = []
        self.servo_lag_s = 0.0
        self.speeds: list[float] = []
        self.speed_acceleration = 0.0
        self.moves_asynchronously = False
        self._writes = self._operation = 0

    def doubles(self, first: int, count: int = JOINTS) -> list[float]:
        """Return double inputs of the script."""
        return self.robot.input_doubles(self.first + first, count)

    def double(self, number: int) -> float:
        """Return one double input of the script."""
        return self.doubles(number, 1)[0]

    def integer(self, number: int) -> int:
        """Return an integer input of the script."""
        return self.robot.input_int(self.first + number)

    def answer(self, values: list[float]) -> None:
        """Write a vector to the double outputs."""
        self.robot.write_doubles(self.first, values)

    def answer_flag(self, value: bool) -> None:
        """Write a yes or no to integer output 1."""
        self.robot.write_int(self.first + 1, int(value))

    def report_progress(self, *, begins: bool) -> None:
        """Report that an asynchronous motion begins or has ended."""
        self._writes = (self._writes + 1) % COUNTER_LIMIT
        if begins:
            self._operation = (self._operation + 1) % COUNTER_LIMIT
        value = (self._writes << PROGRESS_WRITES) + (self._operation << PROGRESS_OPERATION)
        self.robot.write_int(self.first + 2, value + PROGRESS_RUNNING if begins else value)

    def end_asynchronous(self) -> None:
        """End a motion that runs beside the loop."""
        if self.moves_asynchronously:
            self.moves_asynchronously = False
            self.beside = None
            self.report_progress(begins=False)

    def run_asynchronously(self, motion: Iterator[None]) -> None:
        """Run a motion beside the loop."""

        def reported() -> Iterator[None]:
            yield from motion
            self.moves_asynchronously = False
            self.report_progress(begins=False)

        self.report_progress(begins=True)
        self.moves_asynchronously = True
        self.beside = reported()

    def move(self, motion: Iterator[None]) -> Iterator[None] | None:
        """Return a motion to wait for, or have it run beside the loop if the command asks for that."""
        self.end_asynchronous()
        self.beside = None
        if self.integer(1) == 1:
            self.run_asynchronously(motion)
            return None
        return motion

    def steps(self) -> Iterator[None]:
        """Run the loop."""
        self.report_progress(begins=False)
        executing = False
        while True:
            command = self.integer(0)
            if command in CONTINUOUS:
                self._process(command)
                self._signal(READY)
            elif command == NO_COMMAND:
                executing = False
                self._signal(READY)
            elif not executing:
                executing = True
                if command == END_COMMAND:
                    return
                waiting = self._process(command)
                if waiting is not None:
                    yield from waiting
                self._signal(DONE)
            if self.program.failure:
                return
            if self.beside is not None and next(self.beside, self) is self:
                self.beside = None
            yield

    def _signal(self, value: int) -> None:
        self.robot.write_int(self.first, value)

    def _process(self, command: int) -> Iterator[None] | None:
        handler = HANDLERS.get(command)
        return None if handler is None else handler(self)


def register_loop(robot: Robot, program: UrProgram, first_register: int) -> Iterator[None]:
    """Run the script with its registers from that number on."""
    return RegisterLoop(robot, program, first_register).steps()


# -- motions


def _move_joints_to_pose(loop: RegisterLoop) -> Iterator[None] | None:
    joints = _inverse(loop, loop.robot.drives.target)
    if joints is None:
        loop.program.failure = "get_inverse_kin: no solution"
        return None
    return loop.move(movej(loop.robot, joints, loop.double(6), loop.double(7)))


def _move_line_to_joints(loop: RegisterLoop) -> Iterator[None] | None:
    pose = loop.robot.tool_pose(loop.doubles(0))
    return loop.move(movel(loop.robot, pose, loop.double(6), loop.double(7)))


def _servo_line(loop: RegisterLoop) -> None:
    joints = _inverse(loop, loop.robot.drives.target)
    if joints is not None:
        _servo_to(loop, joints)


def _servo_to(loop: RegisterLoop, goal_rad: list[float]) -> None:
    loop.servo_goal = goal_rad
    loop.servo_lag_s = max(0.03, loop.double(9)) + loop.robot.parameters.servoj_lag_s
    if loop.beside is None:
        loop.beside = _servo_thread(loop)


def _servo_thread(loop: RegisterLoop) -> Iterator[None]:
    while True:
        loop.robot.drives.servo(loop.servo_goal, loop.servo_lag_s)
        yield


def _speed(loop: RegisterLoop, approach: Approach) -> None:
    loop.speeds, loop.speed_acceleration = loop.doubles(0), loop.double(6)
    if loop.beside is None:
        loop.beside = _speed_thread(loop, approach)


def _speed_thread(loop: RegisterLoop, approach: Approach) -> Iterator[None]:
    while True:
        approach(loop.robot, loop.speeds, loop.speed_acceleration)
        yield


def _end_thread(loop: RegisterLoop) -> Iterator[None] | None:
    loop.beside = None
    return stopj(loop.robot, loop.double(0))


def _stop(loop: RegisterLoop) -> Iterator[None] | None:
    loop.end_asynchronous()
    loop.beside = None
    motion = stopj(loop.robot, loop.double(0))
    if loop.integer(1) == 1:
        loop.run_asynchronously(motion)
        return None
    return motion


# -- settings and look-ups


def _set_payload(loop: RegisterLoop) -> None:
    centre = loop.doubles(1, 3)
    loop.robot.set_payload(loop.double(0), centre if any(centre) else None)


def _protective_stop(loop: RegisterLoop) -> None:
    loop.robot.stop_request = COMMANDED_STOP


def _set_watchdog(loop: RegisterLoop) -> None:
    rate_hz = loop.double(0)
    if rate_hz > 0.0:
        cycles = round(1.0 / rate_hz / loop.robot.cycle_s)
        loop.program.watchdog = Watchdog(INPUT_INTS + loop.first, cycles, "stop")


def _inverse(loop: RegisterLoop, near_rad: list[float]) -> list[float] | None:
    return loop.robot.joints_at(frame_of_pose(loop.doubles(0)), near_rad)


def _forward_of(loop: RegisterLoop) -> None:
    flange = loop.robot.kinematics.flange(loop.doubles(0))
    loop.answer(pose_of_frame(compose(flange, frame_of_pose(loop.doubles(6)))))


def _pose_trans(loop: RegisterLoop) -> None:
    loop.answer(pose_of_frame(compose(frame_of_pose(loop.doubles(0)), frame_of_pose(loop.doubles(6)))))


def _flange(loop: RegisterLoop) -> None:
    tool = loop.robot.tool_frame(loop.robot.drives.actual)
    loop.answer(pose_of_frame(compose(tool, inverted(loop.robot.tcp))))


def _within_limits(joints_rad: list[float] | None) -> bool:
    return joints_rad is not None and all(abs(angle) <= JOINT_RANGE_RAD for angle in joints_rad)


HANDLERS: Final[dict[int, Handler]] = {
    1: lambda loop: loop.move(movej(loop.robot, loop.doubles(0), loop.double(6), loop.double(7))),
    2: _move_joints_to_pose,
    3: lambda loop: loop.move(movel(loop.robot, loop.doubles(0), loop.double(6), loop.double(7))),
    4: _move_line_to_joints,
    9: lambda loop: _speed(loop, speedj),
    10: lambda loop: _speed(loop, speedl),
    11: lambda loop: _servo_to(loop, loop.doubles(0)),
    15: _end_thread,
    16: _end_thread,
    17: _set_payload,
    24: _servo_line,
    26: lambda loop: loop.answer([loop.robot.cycle_s]),
    27: lambda loop: loop.answer(loop.robot.drives.actual),
    29: lambda loop: loop.robot.set_tcp(loop.doubles(0)),
    30: lambda loop: loop.answer(_inverse(loop, loop.doubles(6)) or [0.0] * JOINTS),
    31: _protective_stop,
    33: _stop,
    34: _stop,
    35: _set_watchdog,
    36: lambda loop: loop.answer_flag(_within_limits(_inverse(loop, loop.robot.drives.actual))),
    37: lambda loop: loop.answer_flag(_within_limits(loop.doubles(0))),
    38: lambda loop: loop.answer(loop.robot.values[_TORQUES]),
    39: _pose_trans,
    40: lambda loop: loop.answer(pose_of_frame(loop.robot.tcp)),
    43: lambda loop: loop.answer(loop.robot.tool_pose(loop.robot.drives.actual)),
    44: _forward_of,
    46: lambda loop: loop.answer(_inverse(loop, loop.robot.drives.actual) or [0.0] * JOINTS),
    47: lambda loop: loop.answer_flag(loop.robot.drives.at_rest),
    58: _flange,
    60: lambda loop: loop.answer_flag(_inverse(loop, loop.robot.drives.actual) is not None),
    61: lambda loop: loop.answer_flag(_inverse(loop, loop.doubles(6)) is not None),
}
