"""External Control: the robot dials the client, and follows what it streams."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import isclose
from struct import pack

import pytest

from ronna_hw.wire.universal_robots import RuntimeState
from sim.universal_robots.controller import Controller
from sim.universal_robots.programs.external_control import ControlMode
from sim.universal_robots.programs.external_trajectory import (
    CUBIC,
    QUINTIC,
    PointType,
    TrajectoryOrder,
    TrajectoryResult,
)
from sim.universal_robots.programs.joint_spline import BRAKING_RAD_S2, cubic, quintic
from sim.universal_robots.programs.recognition import FIRST_WAIT_S, QUIET_S, recognise, requested_program
from sim.universal_robots.variables import OUTPUT_DOUBLES

UNITS = 1_000_000
LIMIT_S = 10.0
SCRIPT = """def externalControl():
  MULT_jointstate = 1000000
  MULT_time = 1000000
  STOPJ_ACCELERATION = 4.0
  REVERSE_INTERFACE_DATA_DIMENSION = 8
  SCRIPT_COMMAND_DATA_DIMENSION = 28
  JOINT_IGNORE_SPEED = 20.0
  servoj(q, t=steptime, lookahead_time=0.03, gain=2000)
  connect_socket_with_retry("{host}", {reverse}, "reverse_socket")
  connect_socket_with_retry("{host}", {trajectory}, "trajectory_socket")
  connect_socket_with_retry("{host}", {commands}, "script_command_socket")
  write_output_float_register(1, splineTimerTraveled)
  socket_send_int(TRAJECTORY_RESULT_CANCELED, "trajectory_socket")
end"""


class Client:
    """A client of a controller without a clock: each message is one cycle."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        names = ("trajectory", "commands", "reverse")
        self._listeners = {name: socket.create_server(("127.0.0.1", 0)) for name in names}
        self.sockets: dict[str, socket.socket] = {}

    def script(self, host: str = "127.0.0.1") -> str:
        ports = {name: listener.getsockname()[1] for name, listener in self._listeners.items()}
        return SCRIPT.format(host=host, **ports)

    def start(self, host: str = "127.0.0.1") -> None:
        program = recognise(self.script(host), self.controller.model.cycle_s)
        assert not self.controller.start(program)

    def accept(self) -> None:
        """Accept in the order in which the robot dials."""
        self.controller.step()
        for name, listener in self._listeners.items():
            listener.settimeout(LIMIT_S)
            self.sockets[name] = listener.accept()[0]
            self.sockets[name].settimeout(LIMIT_S)
            self.controller.step()

    def send(self, mode: ControlMode, values: Sequence[float] = (0.0,) * 6, limit_ms: int = 20) -> None:
        numbers = [round(value * UNITS) for value in values]
        self.sockets["reverse"].sendall(pack(">8i", limit_ms, *numbers, mode))
        self.controller.step()

    def order(self, order: TrajectoryOrder, count: int) -> None:
        self.sockets["reverse"].sendall(pack(">8i", 0, order, count, 0, 0, 0, 0, ControlMode.FORWARD))
        self.controller.step()

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.controller.step()

    def close(self) -> None:
        for one in (*self._listeners.values(), *self.sockets.values()):
            one.close()


@pytest.fixture
def dialled(controller: Controller) -> Iterator[Client]:
    client = Client(controller)
    client.start()
    client.accept()
    yield client
    controller.stop()
    client.close()


def target(client: Client) -> list[float]:
    return client.controller.robot.drives.target


def test_the_first_message_is_awaited_for_ever(dialled: Client) -> None:
    dialled.steps(1000)
    assert dialled.controller.runtime_state is RuntimeState.PLAYING


def test_set_points_of_servoj_are_followed(dialled: Client) -> None:
    goal = [angle + 0.01 for angle in target(dialled)]
    for _ in range(200):
        dialled.send(ControlMode.SERVOJ, goal)
    assert target(dialled) == pytest.approx(goal, abs=1e-5)


def test_a_missed_set_point_is_extrapolated_with_the_speed_of_the_target(dialled: Client) -> None:
    start = target(dialled)
    for number in range(1, 101):
        dialled.send(ControlMode.SERVOJ, [start[0] + 0.001 * number, *start[1:]])
    before, speed = target(dialled)[0], dialled.controller.robot.drives.target_speed[0]
    dialled.steps(5)
    assert target(dialled)[0] - before == pytest.approx(5 * 0.002 * speed, rel=0.05)


@pytest.mark.parametrize(("limit_ms", "cycles"), [(20, 10), (100, 50)])
def test_a_silent_client_is_given_up_after_its_limit(dialled: Client, limit_ms: int, cycles: int) -> None:
    for _ in range(50):
        dialled.send(ControlMode.SPEEDJ, (0.1, 0, 0, 0, 0, 0), limit_ms)
    dialled.steps(cycles)
    assert isclose(dialled.controller.robot.drives.target_speed[0], 0.1)
    dialled.steps(1)
    speed = dialled.controller.robot.drives.target_speed[0]
    assert 0.1 - speed == pytest.approx(4.0 * 0.002)  # stopj(4.0)
    dialled.steps(20)
    assert dialled.controller.runtime_state is RuntimeState.STOPPED


def test_a_client_that_has_gone_ends_the_program_at_once(dialled: Client) -> None:
    dialled.send(ControlMode.IDLE, limit_ms=0)
    dialled.sockets["reverse"].close()
    dialled.steps(3)
    assert dialled.controller.program is None


def test_a_step_that_needs_more_than_20_rad_per_s_is_ignored(dialled: Client) -> None:
    start = target(dialled)
    dialled.send(ControlMode.SERVOJ, [start[0] + 20.5 * 0.002, *start[1:]])
    dialled.steps(5)
    assert target(dialled) == start
    dialled.send(ControlMode.SERVOJ, [start[0] + 19.5 * 0.002, *start[1:]])
    assert target(dialled) != start


def test_a_pose_is_followed(dialled: Client) -> None:
    robot = dialled.controller.robot
    pose = robot.tool_pose(target(dialled))
    pose[2] += 0.005
    for _ in range(200):
        dialled.send(ControlMode.POSE, pose)
    assert robot.tool_pose(target(dialled))[:3] == pytest.approx(pose[:3], abs=1e-4)


def test_stopped_ends_the_program(dialled: Client) -> None:
    dialled.send(ControlMode.IDLE)
    dialled.send(ControlMode.STOPPED)
    dialled.steps(2)
    assert dialled.controller.program is None
    assert dialled.sockets["reverse"].recv(1) == b""


def test_points_of_a_trajectory_are_reached_and_its_result_is_told(dialled: Client) -> None:
    start = target(dialled)
    goal = [start[0] + 0.1, *start[1:]]
    back = [start[0] + 0.05, *start[1:]]
    for joints, kind, spline, time_s in (
        (goal, PointType.MOVEJ, 0, 0.5),
        (back, PointType.SPLINE, QUINTIC, 0.5),
    ):
        numbers = [
            *(round(angle * UNITS) for angle in joints),
            *(0,) * 12,
            round(time_s * UNITS),
            spline,
            kind,
        ]
        dialled.sockets["trajectory"].sendall(pack(">21i", *numbers))
    dialled.order(TrajectoryOrder.RECEIVE, 2)
    dialled.steps(255)
    assert target(dialled)[0] == pytest.approx(goal[0], abs=1e-3)
    dialled.steps(255)
    assert target(dialled) == pytest.approx(back, abs=2e-6)
    assert dialled.sockets["trajectory"].recv(4) == pack(">i", TrajectoryResult.SUCCESS)


def test_a_cancelled_trajectory_stops_the_arm_and_says_so(dialled: Client) -> None:
    goal = [round((angle + 0.5) * UNITS) for angle in target(dialled)]
    dialled.sockets["trajectory"].sendall(pack(">21i", *goal, *(0,) * 12, UNITS, 0, PointType.MOVEJ) * 2)
    dialled.order(TrajectoryOrder.RECEIVE, 2)
    dialled.steps(100)
    dialled.order(TrajectoryOrder.CANCEL, 0)
    dialled.steps(200)
    assert not dialled.controller.robot.drives.moving
    assert dialled.sockets["trajectory"].recv(4) == pack(">i", TrajectoryResult.CANCELLED)


def spline_point(
    joints: Sequence[float], time_s: float, speeds: Sequence[float] = (0.0,) * 6, kind: int = CUBIC
) -> bytes:
    angles = [round(value * UNITS) for value in (*joints, *speeds)]
    return pack(">21i", *angles, *(0,) * 6, round(time_s * UNITS), kind, PointType.SPLINE)


def result_of(client: Client, cycles: int = 2000) -> int | None:
    """Run until a result is told."""
    trajectory = client.sockets["trajectory"]
    trajectory.setblocking(False)
    for _ in range(cycles):
        client.controller.step()
        with suppress(BlockingIOError):
            return int.from_bytes(trajectory.recv(4), "big")
    return None


@pytest.mark.parametrize("kind", [CUBIC, QUINTIC])
def test_a_trajectory_that_ends_with_a_speed_is_slowed_on_its_path_and_shows_its_time(
    dialled: Client, kind: int
) -> None:
    goal = [target(dialled)[0] + 0.3, *target(dialled)[1:]]
    dialled.sockets["trajectory"].sendall(spline_point(goal, 0.4, (1.5, 0, 0, 0, 0, 0), kind))
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    robot = dialled.controller.robot
    times, slowest = [], 0.0
    while robot.values[OUTPUT_DOUBLES + 1] < 0.4:
        dialled.steps(1)
        times.append(robot.values[OUTPUT_DOUBLES + 1])
        left_s = 0.4 - times[-1] + 2.0 * robot.cycle_s
        slowest = max(slowest, robot.drives.target_speed[0] - BRAKING_RAD_S2 * left_s)
    assert slowest < 0.01
    assert times == sorted(times)
    assert target(dialled) == pytest.approx(goal, abs=2e-6)
    assert result_of(dialled) == TrajectoryResult.SUCCESS


def test_a_point_between_splines_is_passed_with_its_speed(dialled: Client) -> None:
    start = target(dialled)
    middle, goal = [start[0] + 0.1, *start[1:]], [start[0] + 0.2, *start[1:]]
    points = spline_point(middle, 0.2, (0.5, 0, 0, 0, 0, 0)) + spline_point(goal, 0.4)
    dialled.sockets["trajectory"].sendall(points)
    dialled.order(TrajectoryOrder.RECEIVE, 2)
    dialled.steps(99)
    assert target(dialled)[0] == pytest.approx(middle[0], abs=0.002)
    assert dialled.controller.robot.drives.target_speed[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("ahead_rad", "time_s", "result"),
    [
        (0.0, 0.0, TrajectoryResult.SUCCESS),  # already there
        (0.1, 0.0, TrajectoryResult.CANCELLED),
        (0.5, 0.02, TrajectoryResult.CANCELLED),  # 25 rad/s
    ],
)
def test_a_spline_without_enough_time_is_cancelled_and_the_arm_rests(
    dialled: Client, ahead_rad: float, time_s: float, result: TrajectoryResult
) -> None:
    start = target(dialled)
    dialled.sockets["trajectory"].sendall(spline_point([start[0] + ahead_rad, *start[1:]], time_s))
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    assert result_of(dialled) == result
    assert target(dialled) == start
    assert dialled.controller.program is not None


def test_a_new_trajectory_discards_the_points_that_are_left_of_the_last(dialled: Client) -> None:
    start = target(dialled)
    first, second = [start[0] + 0.1, *start[1:]], [start[0] - 0.1, *start[1:]]
    dialled.sockets["trajectory"].sendall(spline_point(first, 0.3) * 3)
    dialled.order(TrajectoryOrder.RECEIVE, 3)
    dialled.steps(20)
    dialled.sockets["trajectory"].sendall(spline_point(second, 0.3))
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    assert result_of(dialled) == TrajectoryResult.SUCCESS
    assert target(dialled) == pytest.approx(second, abs=2e-6)


def test_a_point_without_motion_takes_a_cycle(dialled: Client) -> None:
    here = [round(angle * UNITS) for angle in target(dialled)]
    dialled.controller.robot.drives.place([angle / UNITS for angle in here])
    dialled.steps(2)
    dialled.sockets["trajectory"].sendall(pack(">21i", *here, *(0,) * 14, PointType.MOVEJ) * 10)
    dialled.order(TrajectoryOrder.RECEIVE, 10)
    assert result_of(dialled, cycles=8) is None
    assert result_of(dialled) == TrajectoryResult.SUCCESS


def test_a_joint_beyond_its_range_ends_the_program(dialled: Client) -> None:
    goal = [123 * UNITS, *(0,) * 17, 0, 0, PointType.MOVEJ]
    dialled.sockets["trajectory"].sendall(pack(">21i", *goal))
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    dialled.steps(2)
    assert dialled.controller.program is None


def test_the_arc_of_a_trajectory_ends_at_its_pose(dialled: Client) -> None:
    robot = dialled.controller.robot
    x, y, z, *turn = robot.tool_pose(target(dialled))
    goal, via = (x, y + 0.1, z, *turn), (x, y + 0.05, z + 0.05, *turn)
    numbers = [round(value * UNITS) for value in (*goal, *via, 0.5, 2.0, 0, 0, 0, 0)]
    dialled.sockets["trajectory"].sendall(pack(">21i", *numbers, 0, 0, PointType.MOVEC))
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    assert result_of(dialled) == TrajectoryResult.SUCCESS
    assert robot.tool_pose(target(dialled))[:3] == pytest.approx(goal[:3], abs=1e-5)


@pytest.mark.parametrize("is_silent", [True, False])
def test_what_follows_the_loop_is_opened_unless_the_client_fell_silent(
    controller: Controller, *, is_silent: bool
) -> None:
    client = Client(controller)
    with socket.create_server(("127.0.0.1", 0)) as after:
        after.settimeout(LIMIT_S)
        port = after.getsockname()[1]
        line = f'  socket_open("127.0.0.1", {port}, "test_socket")'
        controller.start(recognise(f"{client.script()}\n{line}\nend", controller.model.cycle_s))
        client.accept()
        client.send(ControlMode.IDLE)
        if not is_silent:
            client.send(ControlMode.STOPPED)
        client.steps(20)
        after.settimeout(0.0 if is_silent else LIMIT_S)
        if is_silent:
            with pytest.raises(BlockingIOError):
                after.accept()
        else:
            after.accept()[0].close()
    controller.stop()
    client.close()


def test_a_missing_point_is_a_failure(dialled: Client) -> None:
    dialled.order(TrajectoryOrder.RECEIVE, 1)
    dialled.steps(300)
    assert dialled.sockets["trajectory"].recv(4) == pack(">i", TrajectoryResult.FAILURE)


def test_the_tool_is_set_by_a_script_command(dialled: Client) -> None:
    dialled.sockets["commands"].sendall(pack(">28i", 10, 0, 0, UNITS // 10, *(0,) * 24))
    dialled.send(ControlMode.IDLE, limit_ms=0)
    assert dialled.controller.robot.tcp.z == pytest.approx(0.1)


@pytest.mark.parametrize("host", ["192.168.1.2", "robot.example", "0.0.0.0"])
def test_no_other_computer_is_dialled(controller: Controller, host: str) -> None:
    client = Client(controller)
    client.start(host)
    controller.step()
    assert controller.program is not None
    assert host in controller.program.failure
    client.close()


def request_script(controller: Controller, answer: str, *, hangs_up: bool) -> list[str]:
    """Play the program of the pendant and answer its request; returns the reports of failure."""
    failures: list[str] = []
    controller.news.failure.append(lambda text, _line: failures.append(text))
    with socket.create_server(("127.0.0.1", 0)) as sender:
        sender.settimeout(LIMIT_S)
        assert not controller.start(requested_program("external_control.urp", *sender.getsockname()))
        controller.step()
        connection = sender.accept()[0]
        controller.step()
        with connection:
            assert connection.recv(100) == b"request_program\n"
            connection.sendall(answer.encode())
            if hangs_up:
                connection.close()
            for _ in range(round(max(QUIET_S, 0.0 if answer else FIRST_WAIT_S) / controller.robot.cycle_s)):
                controller.step()
    return failures


def test_the_program_of_the_pendant_runs_the_script_that_it_requested(controller: Controller) -> None:
    client = Client(controller)
    assert not request_script(controller, client.script(), hangs_up=False)
    client.accept()
    client.send(ControlMode.IDLE, limit_ms=0)
    assert controller.runtime_state is RuntimeState.PLAYING
    client.send(ControlMode.STOPPED)
    client.steps(2)
    assert controller.program is None
    client.close()


@pytest.mark.parametrize("hangs_up", [True, False])
def test_without_a_script_the_program_of_the_pendant_fails(controller: Controller, hangs_up: bool) -> None:
    (failure,) = request_script(controller, "", hangs_up=hangs_up)
    assert "no script" in failure


@pytest.mark.parametrize("host", ["192.168.1.2", "127.0.0.1"])
def test_a_program_of_the_pendant_that_reaches_no_client_fails(controller: Controller, host: str) -> None:
    failures: list[str] = []
    controller.news.failure.append(lambda text, _line: failures.append(text))
    with socket.create_server(("127.0.0.1", 0)) as sender:
        port = sender.getsockname()[1]
    controller.start(requested_program("external_control.urp", host, port))
    while controller.program is not None:
        controller.step()
    assert failures == [f"external_control.urp: no connection to {host}:{port}"]


def test_splines_meet_their_ends() -> None:
    for coefficients in (
        cubic((0.1, 0.2), (0.5, -0.3), 2.0),
        quintic((0.1, 0.2, 0.4), (0.5, -0.3, 0.7), 2.0),
    ):
        end = sum(value * 2.0**power for power, value in enumerate(coefficients))
        speed = sum(power * value * 2.0 ** (power - 1) for power, value in enumerate(coefficients) if power)
        assert (end, speed) == (pytest.approx(0.5), pytest.approx(-0.3))
