"""Scripts, state packages and the dashboard's answers."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterator

import pytest
from ur_clients import script

from ronna_hw.host.network import own_address
from ronna_hw.wire.universal_robots import SafetyMode
from sim.universal_robots.connections import Poll
from sim.universal_robots.controller import Controller
from sim.universal_robots.interfaces.clients import ClientInterfaces, ScriptText
from sim.universal_robots.interfaces.dashboard import Dashboard
from sim.universal_robots.interfaces.state_packages import StatePackages
from sim.universal_robots.model import ALPHA_RAD
from sim.universal_robots.programs.program import ScriptPlace
from sim.universal_robots.programs.recognition import recognise
from sim.universal_robots.variables import DIGITAL_OUTPUTS

MakeController = Callable[..., Controller]
LIMIT_S = 10.0
MESSAGE = 20  # type of a package


@pytest.fixture
def poll() -> Iterator[Poll]:
    poll = Poll()
    yield poll
    poll.close()


@pytest.fixture
def ask(controller: Controller, poll: Poll) -> Iterator[Callable[[str], str]]:
    dashboard = Dashboard(controller, own_address(), poll)
    yield dashboard.answer
    dashboard.listener.close()


def parts(package: bytes) -> dict[int, bytes]:
    """The payloads of a robot state by their kind."""
    size, kind = struct.unpack_from(">iB", package)
    assert (size, kind) == (len(package), 16)
    found, start = {}, 5
    while start < size:
        length, number = struct.unpack_from(">IB", package, start)
        found[number] = package[start + 5 : start + length]
        start += length
    return found


# -- scripts


def test_programs_are_split_from_lines_however_the_bytes_arrive() -> None:
    text = f"stop program\r\n{script()}\n# a comment\nset_digital_out(1, True)\n"
    whole = ScriptText(10_000)
    found = [one for byte in text.encode() for one in whole.feed(bytes([byte]))]
    assert [one.partition("\n")[0] for one in found] == [
        "stop program",
        "def ronna_stream():",
        "set_digital_out(1, True)",
    ]
    assert found[1] == script().rstrip()


def test_a_text_without_end_is_refused() -> None:
    with pytest.raises(ValueError, match="without end"):
        list(ScriptText(1000).feed(b"def endless():\n" + b"  sync()\n" * 200))


def test_a_program_of_plain_statements_is_carried_out(controller: Controller) -> None:
    goal = [angle + 0.05 for angle in controller.robot.drives.target]
    text = f"def plain():\n  set_digital_out(3, True)\n  movej({goal}, a=5.0, v=1.0)\nend"
    controller.start(recognise(text, controller.model.cycle_s))
    for _ in range(500):
        controller.step()
    assert controller.robot.drives.target == goal
    assert controller.robot.values[DIGITAL_OUTPUTS] == 1 << 3


def test_the_text_of_a_program_is_told_once_it_is_said(controller: Controller) -> None:
    told: list[tuple[int, str]] = []
    controller.news.text.append(lambda text: told.append((controller.cycles, text)))
    text = 'def plain():\n  textmsg("before")\n  sleep(0.1)\n  textmsg("after")\nend'
    controller.start(recognise(text, controller.model.cycle_s))
    for _ in range(60):
        controller.step()
    assert told == [(1, "before"), (51, "after")]
    message = StatePackages(controller).text("before")
    assert message_kinds(message) == [(MESSAGE, 0)]
    assert message.endswith(b"before")


@pytest.mark.parametrize("head", ["def", "sec"])
def test_a_protective_stop_by_its_name_has_a_code_of_its_own(
    controller: Controller, poll: Poll, head: str
) -> None:
    clients = ClientInterfaces(controller, own_address(), poll)
    codes: list[int] = []
    controller.news.error.append(lambda code, _text: codes.append(code))
    clients.take(f"{head} stop():\n  protective_stop()\nend")
    for _ in range(3):
        controller.step()
    for listener in clients.listeners:
        listener.close()
    assert codes == [209]
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert controller.program is None


def test_a_joint_motion_to_a_pose_out_of_reach_is_a_runtime_exception(controller: Controller) -> None:
    failures: list[str] = []
    controller.news.failure.append(lambda text, _place: failures.append(text))
    controller.start(recognise("movej(p[10,0,0,0,0,0])", controller.model.cycle_s))
    controller.step()
    assert failures == ["get_inverse_kin: no solution"]


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("def a():\n  movej(q_target)\nend", ("compile_error_name_not_found:movej:", (2, 3))),
        (
            "def a():\n  # none\n  freedrive_mode()\nend",
            ("compile_error_name_not_found:freedrive_mode:", (3, 3)),
        ),
        ("sec a():\n  while True:\n  end\nend", ("syntax_error_on_line:2:while True:", (2, 3))),
    ],
)
def test_a_script_that_is_not_simulated_is_answered_as_one_that_a_controller_cannot_compile(
    controller: Controller, poll: Poll, text: str, answer: tuple[str, tuple[int, int]]
) -> None:
    clients = ClientInterfaces(controller, own_address(), poll)
    said: list[tuple[str, tuple[int, int]]] = []
    controller.news.failure.append(lambda text, place: said.append((text, place)))
    clients.take(text)
    for _ in range(round(controller.parameters.script_start_s / controller.model.cycle_s) + 1):
        clients.send_state()
    for listener in clients.listeners:
        listener.close()
    assert said == [answer]
    assert controller.program is None


def test_a_runtime_exception_names_its_line_and_column(controller: Controller) -> None:
    message = StatePackages(controller).runtime_exception(
        "compile_error_name_not_found:a:", ScriptPlace(3, 5)
    )
    assert message_kinds(message) == [(MESSAGE, 10)]
    assert struct.unpack_from(">ii", message, 15) == (3, 5)


# -- state


def test_the_state_has_the_documented_parts(controller: Controller) -> None:
    found = parts(StatePackages(controller).state())
    sizes = {0: 42, 1: 6 * 41, 3: 70, 4: 96, 5: 220, 6: 440}
    assert {kind: len(found[kind]) for kind in sizes} == sizes
    assert struct.unpack_from(">3d", found[1]) == (0.0, 0.0, 0.0)


def test_the_kinematics_are_the_parameters_in_metres_and_rad(controller: Controller) -> None:
    payload = parts(StatePackages(controller).state())[5]
    theta, a, d, alpha = (struct.unpack_from(">6d", payload, 24 + 48 * column) for column in range(4))
    assert theta == (0.0,) * 6
    assert a == (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
    assert d == (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
    assert alpha == ALPHA_RAD


@pytest.mark.parametrize(("size", "payload_bytes"), [("38", 33), ("46", 41), ("47", 42)])
def test_the_mode_part_has_the_size_of_its_age(make: MakeController, size: str, payload_bytes: int) -> None:
    assert len(parts(StatePackages(make(f"robot_mode_bytes={size}")).state())[0]) == payload_bytes


@pytest.mark.parametrize(("arm", "size"), [("ur5", 1108), ("ur5e", 1220)])
def test_the_realtime_package_has_the_size_of_its_version(make: MakeController, arm: str, size: int) -> None:
    package = StatePackages(make(arm=arm)).realtime()
    assert struct.unpack_from(">i", package) == (size,)
    assert len(package) == size


def test_secondary_clients_get_the_version_and_states_but_no_other_messages(
    controller: Controller, poll: Poll
) -> None:
    clients = ClientInterfaces(controller, own_address(), poll)
    kinds = {}
    for listener in clients.primary, clients.secondary:
        host, port = listener.endpoint.removeprefix("tcp://").split(":")
        with socket.create_connection((host, int(port)), timeout=LIMIT_S) as client:
            while not listener.connections:
                poll.serve(LIMIT_S)
            controller.hold(SafetyMode.SAFEGUARD_STOP)
            controller.hold(SafetyMode.SAFEGUARD_STOP, holds=False)
            kinds[port] = message_kinds(client.recv(65536))
        listener.close()
    clients.realtime.close()
    state, version, safety = (16, None), (20, 3), (20, 5)
    assert list(kinds.values()) == [[version, state, state, safety, state, safety], [version, state]]


def test_a_resting_controller_sends_its_state_as_often_on_the_clock_of_its_clients(
    controller: Controller, poll: Poll, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, period_s = [1000.0], controller.parameters.state_period_s
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    clients = ClientInterfaces(controller, own_address(), poll)
    host, port = clients.primary.endpoint.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=LIMIT_S) as client:
        while not clients.primary.connections:
            poll.serve(LIMIT_S)
        client.recv(65536)  # what every client is told first
        cycles = {"fast": (100, 0.0), "in real time": (100, 0.002), "at rest": (2, period_s)}
        states = {}
        for pace, (number, cycle_s) in cycles.items():
            for _ in range(number):
                now_s[0] += cycle_s
                controller.step()
                clients.send_state()
            states[pace] = message_kinds(client.recv(65536)).count((16, None))
    for listener in clients.listeners:
        listener.close()
    assert states == dict.fromkeys(cycles, 2)


def message_kinds(data: bytes) -> list[tuple[int, int | None]]:
    """The type of each package, and the kind of each message."""
    found = []
    while data:
        size, kind = struct.unpack_from(">iB", data)
        found.append((kind, data[14] if kind == MESSAGE else None))
        data = data[size:]
    return found


# -- dashboard


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("SafetyMode", "Safetymode: NORMAL"),
        ("power on", "Powering on"),
        ("stop", "Stopped"),
        ("play", "Failed to execute: play"),
        ("get loaded program", "No program loaded"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("is in remote control", "true"),
        ("popup hello there", "showing popup"),
        ("load installation default.installation", "Loading installation: default.installation"),
        ("set operational mode manual", "Operational mode MANUAL is set"),
        ("setUserRole locked", "Setting user role: LOCKED"),
        ("generate support file .", "Completed successfully: ./ur_support_file.zip"),
        ("running", "Program running: false"),
    ],
)
def test_the_dashboard_answers(ask: Callable[[str], str], line: str, answer: str) -> None:
    assert ask(line) == answer


@pytest.mark.parametrize(("arm", "version"), [("ur5e", "5.21.0."), ("ur5", "3.15.8.")])
def test_a_later_software_is_one_of_the_e_series(make: MakeController, arm: str, version: str) -> None:
    assert make("software=5.21.0", arm=arm).model.version_text.startswith(version)


def test_a_loaded_program_plays_pauses_and_stops(ask: Callable[[str], str], controller: Controller) -> None:
    assert ask("load wait_program.urp") == "Loading program: wait_program.urp"
    assert ask("play") == "Starting program"
    controller.step()
    assert ask("programState") == "PLAYING wait_program.urp"
    assert ask("pause") == "Pausing program"
    controller.step()
    assert ask("play") == "Starting program"
    ask("stop")
    controller.step()
    assert ask("running") == "Program running: false"


def test_a_loaded_external_control_program_requests_its_script(make: MakeController, poll: Poll) -> None:
    with socket.create_server(("127.0.0.1", 0)) as sender:
        sender.settimeout(LIMIT_S)
        controller = make(f"external_control_port={sender.getsockname()[1]}")
        dashboard = Dashboard(controller, own_address(), poll)
        dashboard.answer("load external_control.urp")
        assert dashboard.answer("play") == "Starting program"
        controller.step()
        with sender.accept()[0] as connection:
            controller.step()
            assert connection.recv(100) == b"request_program\n"
    controller.stop()
    dashboard.listener.close()


def test_a_protective_stop_is_not_unlocked_within_five_seconds(
    ask: Callable[[str], str], controller: Controller
) -> None:
    controller.hold(SafetyMode.PROTECTIVE_STOP)
    assert ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s")


def test_in_local_mode_it_only_answers_questions(ask: Callable[[str], str], controller: Controller) -> None:
    controller.modes.local = True
    assert ask("is in remote control") == "false"
    assert ask("power off") == "Command is not allowed due to safety reasons"
