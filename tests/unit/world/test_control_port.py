import contextlib
import json
import math
import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from coded_errors import raises
from user_commands import in_this_process, one_error

from procedures.runs import request_checks
from procedures.runs.request import RunRequest
from ronna_hw.control_port import (
    CONTROL_PORT_OF_ANOTHER,
    LONGEST_LINE,
    ControlAddress,
    ControlPortClient,
    ControlPortSilent,
    ControlRequestRefused,
    ask_control_port,
)
from ronna_hw.errors import EXIT_USAGE
from sim.cli import app as ronna_sim
from sim.world.control_port import MOST_CONNECTIONS, ControlledRoom, ControlPort
from sim.world.displacements import NOTHING_MOVED, ShiftedRoom
from sim.world.faults import parse_faults
from sim.world.saved_world import WORLD_FILE, SavedWorld, read_saved_world
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import ArmState, World

RESET = struct.pack("ii", 1, 0)  # linger for 0 s: closing sends a reset
GUIDE = draw_scene("mini").mount.tool_number_guide
SOON_S = 0.1
MOUNT = b'{"do": "mount", "number": %d}\n' % GUIDE


@pytest.fixture
def world() -> World:
    return World.create(draw_scene("mini"), paced=False)


@pytest.fixture
def room(world: World, tmp_path: Path) -> ControlledRoom:
    return ControlledRoom(world, tmp_path)


@pytest.fixture
def port(room: ControlledRoom) -> Iterator[ControlPort]:
    port = ControlPort(room, first_line_limit_s=SOON_S, idle_limit_s=SOON_S)
    yield port
    port.close()


def _connected(port: ControlPort) -> socket.socket:
    where = ControlAddress.parse(port.endpoint).endpoint
    return socket.create_connection((where.host, where.port), timeout=5)


def _token(port: ControlPort) -> bytes:
    return json.dumps({"token": ControlAddress.parse(port.endpoint).token}).encode() + b"\n"


def _said(line: socket.socket) -> bytes:
    """Everything until the port hangs up, which it must."""
    said = b""
    try:
        while more := line.recv(65536):
            said += more
    except ConnectionResetError:  # what it did not read was thrown away
        pass
    return said


@pytest.mark.parametrize(
    "sent",
    [
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\nTOKEN" + MOUNT,
        MOUNT,
        b'{"token": "guessed"}\n' + MOUNT,
        b'{"token": ["\\ud800"]}\n' + MOUNT,
        b"[" * 60_000 + b"\nTOKEN" + MOUNT,
        b"\nTOKEN" + MOUNT,
        b"TOKEN" + b"tea\n" + MOUNT,
        b"TOKEN" + b"[1]\n" + MOUNT,
        b"TOKEN" + b'{"do": "mount", "number": Infinity}\n' + MOUNT,
        b"TOKEN" + b'{"do": "mount", "number": 1e400}\n' + MOUNT,
        b"TOKEN" + b'{"do": "mount", "number": 1%s}\n' % (b"0" * 400) + MOUNT,
        b"TOKEN" + b"[" * (LONGEST_LINE - 1) + b"\n" + MOUNT,
        b"TOKEN" + b'{"do": "' + b"x" * LONGEST_LINE + b'"}\n' + MOUNT,
    ],
    ids=lambda sent: repr(sent[:24]),
)
def test_a_malformed_or_unauthorised_connection_executes_nothing_and_is_closed(
    port: ControlPort, world: World, sent: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    with _connected(port) as line:
        line.sendall(sent.replace(b"TOKEN", _token(port)))
        said = _said(line)
    assert world.mounted_tool() != GUIDE
    assert b'"ok": true' not in said.removeprefix(b'{"ok": true}\n')
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("number", ['"\\ud800"', "-1", "null", '{"a": 1}'])
def test_a_request_with_an_invalid_value_is_answered_with_the_reason(
    port: ControlPort, world: World, number: str
) -> None:
    with _connected(port) as line:
        line.sendall(_token(port) + b'{"do": "mount", "number": %s}\n' % number.encode())
        answers = [json.loads(answer) for answer in _said(line).splitlines()]
    assert [answer["ok"] for answer in answers] == [True, False]
    assert len(answers[1]["reason"]) <= 500
    assert world.mounted_tool() != GUIDE


def test_an_internal_error_is_answered_and_the_connection_stays_open(
    port: ControlPort, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise IndexError("no such room")

    with ControlPortClient(port.endpoint) as client:
        with monkeypatch.context() as patched:
            patched.setattr(World, "enter_step", fail)
            with pytest.raises(ControlRequestRefused, match="the simulator failed: IndexError"):
                client.ask("step", name="set_up")
        client.ask("mount", number=GUIDE)
    assert world.mounted_tool() == GUIDE


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_a_number_that_is_not_finite_is_refused(port: ControlPort, number: str) -> None:
    shown = one_error(in_this_process(ronna_sim, "work", "skin", number, "--control", port.endpoint).stderr)
    assert shown[0].startswith("CTL-002: work is refused: a number is not finite")


@pytest.mark.parametrize("sent", [b"", b'{"tok', b"TOKEN", b"TOKEN{"])
def test_a_client_that_sends_no_complete_line_is_disconnected(port: ControlPort, sent: bytes) -> None:
    with _connected(port) as line:
        line.sendall(sent.replace(b"TOKEN", _token(port)))
        assert _said(line) in (b"", b'{"ok": true}\n')


def test_a_line_sent_in_drips_is_cut_off_after_the_time_of_one_line(room: ControlledRoom) -> None:
    port = ControlPort(room, first_line_limit_s=SOON_S)
    with _connected(port) as line:
        line.settimeout(SOON_S / 4)
        for _ in range(20):
            try:
                line.sendall(b" ")
                if not line.recv(1):
                    break
            except TimeoutError:
                continue
            except OSError:
                break
        else:
            pytest.fail("the port still listens to drips")
    port.close()


@pytest.mark.parametrize(
    "request_of_staff", [{"do": "step", "name": "registration:T1"}, {"do": "mount", "number": GUIDE}]
)
def test_a_theatre_that_is_killed_continues_from_the_last_request_of_its_staff(
    room: ControlledRoom, world: World, tmp_path: Path, request_of_staff: dict[str, object]
) -> None:
    room.answer({"do": "identify"})
    assert not (tmp_path / WORLD_FILE).exists()
    world.clock.sleep(40.0)
    assert room.answer(request_of_staff)["ok"]
    assert read_saved_world(tmp_path) == SavedWorld.from_world(world)


def test_clients_without_the_token_do_not_keep_out_those_with_it(room: ControlledRoom, world: World) -> None:
    port = ControlPort(room)
    strangers = [_connected(port) for _ in range(3 * MOST_CONNECTIONS)]
    ask_control_port(port.endpoint, "mount", number=GUIDE)
    assert world.mounted_tool() == GUIDE
    trusted = [ControlPortClient(port.endpoint) for _ in range(MOST_CONNECTIONS)]
    with _connected(port) as line:
        assert _said(line) == b""
    for each in (*strangers, *trusted):
        each.close()
    port.close()


def test_a_reset_connection_causes_no_traceback_and_the_next_is_served(
    port: ControlPort, capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(5):
        line = _connected(port)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        line.sendall(_token(port) + b'{"do": "step", "name": "set_up"}\n' * 50)
        line.close()
    ask_control_port(port.endpoint, "step", name="set_up")
    assert "Traceback" not in capfd.readouterr().err


def test_each_port_has_its_own_token_and_explains_the_refusal_of_another(
    port: ControlPort, room: ControlledRoom
) -> None:
    another = ControlPort(room)
    stale = ControlAddress(
        ControlAddress.parse(port.endpoint).endpoint, ControlAddress.parse(another.endpoint).token
    )
    another.close()
    with pytest.raises(ControlRequestRefused, match="token from the READY line"):
        ControlPortClient(stale.text())


@pytest.mark.parametrize("answer", [b"[1]\n", b'"ok"\n', b"HTTP/1.1 400\n", b'{"ok": false, "advice": 5}\n'])
def test_an_answer_of_another_program_is_an_error_of_ours(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other, ThreadPoolExecutor(1) as another:
        there = f"tcp://127.0.0.1:{other.getsockname()[1]}?token=1234"
        asked = another.submit(ControlPortClient, there)
        other.settimeout(5.0)
        line, _ = other.accept()
        with line:
            line.sendall(answer)
            with pytest.raises((ControlPortSilent, ControlRequestRefused)):
                asked.result(5.0)


def test_the_endpoint_is_read_from_the_environment(
    port: ControlPort, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RONNA_CONTROL", port.endpoint)
    assert in_this_process(ronna_sim, "mount", GUIDE).returncode == 0
    assert world.mounted_tool() == GUIDE


def test_one_fault_is_cleared_and_one_that_was_not_injected_is_refused(
    port: ControlPort, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RONNA_CONTROL", port.endpoint)
    for line in ("tracker hot", "robot mode T1", "tracker hot for 2 s"):
        assert in_this_process(ronna_sim, "fault", line).returncode == 0
    assert in_this_process(ronna_sim, "fault", "--clear", "tracker hot").returncode == 0
    (left,) = parse_faults(world.fault_script()[1])
    assert left.phrase == "robot mode T1"
    (refused, *_) = one_error(in_this_process(ronna_sim, "fault", "--clear", "tracker hot").stderr)
    assert "SIM-003: there is no fault 'tracker hot' to clear; expected 'robot mode T1'" in refused
    assert in_this_process(ronna_sim, "fault", "--clear").returncode == 0
    assert world.fault_script()[1] == ""


def test_a_client_may_hide_a_tool_by_the_number_in_which_it_has_loaded_it(
    port: ControlPort, world: World
) -> None:
    ask_control_port(port.endpoint, "fault", line="tracker hide tool 1 for 2 s")
    (fault,) = parse_faults(world.fault_script()[1])
    assert fault.phrase == f"tracker occlude tool {world.scene.tracker.tools[0].name}"
    ask_control_port(port.endpoint, "clear_faults", line="tracker hide tool 1")
    assert world.fault_script()[1] == ""
    with pytest.raises(ControlRequestRefused, match="SIM-003"):
        ask_control_port(port.endpoint, "fault", line="tracker hide tool 99")


def test_an_answer_sent_in_drips_is_given_up_after_the_time_of_one_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ronna_hw.control_port.ANSWER_LIMIT_S", 3 * SOON_S)
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor() as another:

        def drip() -> int:
            drips = 0
            connection, _ = server.accept()
            with connection, contextlib.suppress(OSError):
                connection.settimeout(SOON_S)
                while drips < 100:
                    with contextlib.suppress(TimeoutError):  # as long as between two drips
                        if not connection.recv(1000):
                            break
                    connection.sendall(b" ")
                    drips += 1
            return drips

        dripping = another.submit(drip)
        with pytest.raises(ControlPortSilent, match="timed out"):
            ControlPortClient(f"tcp://127.0.0.1:{server.getsockname()[1]}?token=a")
        assert dripping.result() < 20


MOVE = ("move", "cart", "--by", "60", "-40", "0", "--turn", "5")


@pytest.fixture
def theatre(world: World, port: ControlPort) -> str:
    """The control port of a room with an arm."""
    world.publish_arm(ArmState((0.0,) * 6, np.eye(4), 0, at_rest=True))
    return port.endpoint


def test_staff_move_the_cart_of_the_arm_and_the_time_that_it_takes_passes(theatre: str, world: World) -> None:
    assert in_this_process(ronna_sim, *MOVE, "--control", theatre).returncode == 0
    head = ShiftedRoom(world).now()
    assert head.head_rad == pytest.approx((0.0, 0.0, -math.radians(5.0)))
    assert np.linalg.norm(head.head_mm) == pytest.approx(math.hypot(60.0, 40.0))
    assert world.clock.now_s() == pytest.approx(5.0 / 30.0, abs=1e-3)


def test_a_moved_cart_stays_where_it_is_when_faults_are_cleared_and_the_theatre_ends(
    theatre: str, world: World
) -> None:
    in_this_process(ronna_sim, *MOVE, "--control", theatre)
    there = ShiftedRoom(world).now()
    ask_control_port(theatre, "fault", line="room shift head 0 3 0 mm")
    ask_control_port(theatre, "clear_faults")
    assert ShiftedRoom(world).now() == there
    continued = SavedWorld.from_world(world).restore(world.scene, paced=False)
    assert ShiftedRoom(continued).now() == there


def test_a_live_move_is_along_the_axes_before_a_move_that_is_yet_to_come(theatre: str, world: World) -> None:
    ask_control_port(theatre, "fault", line="at 60 s: room move cart 1 0 0 0 mm 90 deg in 1 s")
    in_this_process(ronna_sim, "move", "cart", "--by", "100", "0", "0", "--control", theatre)
    world.clock.sleep(99.0)
    now = ShiftedRoom(world).now()
    assert now.head_rad == pytest.approx((0.0, 0.0, -math.pi / 2.0))
    assert now.head_mm == pytest.approx((0.0, 100.0, 0.0))  # left of the turned robot


@pytest.mark.parametrize("begins", ["at 60 s", "since step == docking", "since step == look after 60 s"])
def test_clearing_all_faults_cancels_a_cart_move_that_has_not_begun(
    theatre: str, world: World, begins: str
) -> None:
    ask_control_port(theatre, "fault", line=f"{begins}: room move cart 1 100 0 0 mm 0 deg in 1 s")
    ask_control_port(theatre, "step", name="look")
    ask_control_port(theatre, "clear_faults")
    world.clock.sleep(99.0)
    ask_control_port(theatre, "step", name="docking")
    world.clock.sleep(9.0)
    assert ShiftedRoom(world).now() is NOTHING_MOVED


def test_a_cart_moved_in_a_step_stays_there_beyond_it_once_all_faults_are_cleared(
    theatre: str, world: World
) -> None:
    ask_control_port(theatre, "fault", line="when step == look: room move cart 1 100 0 0 mm 0 deg in 1 s")
    ask_control_port(theatre, "step", name="look")
    world.clock.sleep(2.0)
    ask_control_port(theatre, "clear_faults")
    for step in ("docking", "look"):
        ask_control_port(theatre, "step", name=step)
        assert ShiftedRoom(world).now().head_mm == pytest.approx((-100.0, 0.0, 0.0))


def test_a_cart_of_a_continued_theatre_is_not_moved_with_the_instrument_of_the_last_one(
    theatre: str, world: World, tmp_path: Path
) -> None:
    ask_control_port(theatre, "mount", number=GUIDE)
    ask_control_port(theatre, "work", task="depth_stop", trajectory="T1", numbers=[170.0])
    ask_control_port(theatre, "work", task="insert", trajectory="T1")
    continued = ControlledRoom(SavedWorld.from_world(world).restore(world.scene, paced=False), tmp_path)
    move = {"do": "move", "cart": 1, "by_mm": [60, -40, 0], "turn_deg": 5}
    refused = continued.answer(move)
    assert not refused["ok"]
    assert "SIM-017" in refused["reason"]
    assert "T1" in refused["reason"]
    continued.answer({"do": "work", "task": "out"})
    assert continued.answer(move)["ok"]


def test_a_cart_is_moved_with_an_instrument_in_the_guide_only_anyway(theatre: str, world: World) -> None:
    ask_control_port(theatre, "mount", number=GUIDE)
    ask_control_port(theatre, "work", task="depth_stop", trajectory="T1", numbers=[170.0])
    ask_control_port(theatre, "work", task="insert", trajectory="T1")
    shown = one_error(in_this_process(ronna_sim, *MOVE, "--control", theatre).stderr)
    assert "SIM-017" in shown[0]
    assert "T1" in shown[0]
    assert ShiftedRoom(world).now() is NOTHING_MOVED
    assert in_this_process(ronna_sim, *MOVE, "--anyway", "--control", theatre).returncode == 0
    ask_control_port(theatre, "work", task="out", trajectory="T1")
    assert in_this_process(ronna_sim, *MOVE, "--control", theatre).returncode == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("cart", "2", "--by", "60", "0", "0"), "there is no such cart; expected cart 1, got cart 2"),
        (("cart", "--by", "nan", "0", "0"), "expected finite numbers, got by nan 0 0 mm"),
        (("cart", "--by", "60", "0", "0", "--turn", "inf"), "turned by inf deg"),
        (("cart", "--by", "2000", "1", "0"), "limit 2000 mm and 90 deg, got by 2000 1 0 mm"),
        (("cart", "--turn", "-91"), "got by 0 0 0 mm, turned by -91 deg"),
        (("cart",), "would stay where it is"),
    ],
)
def test_a_move_that_cannot_be_made_is_refused_with_its_value(
    theatre: str, world: World, options: tuple[str, ...], said: str
) -> None:
    done = in_this_process(ronna_sim, "move", *options, "--control", theatre)
    assert done.returncode == EXIT_USAGE
    shown = " ".join(one_error(done.stderr))
    assert "SIM-016" in shown
    assert said in shown
    assert ShiftedRoom(world).now() is NOTHING_MOVED


def test_no_cart_is_moved_without_a_theatre_or_with_the_token_of_another(
    theatre: str, world: World, port: ControlPort
) -> None:
    where = ControlAddress.parse(port.endpoint).endpoint
    for control, code in (
        (("--control", f"{where}?token=of-another-theatre"), "CTL-002"),
        (("--control", "tcp://127.0.0.1:9?token=x"), "CTL-001"),
        ((), "CLI-001"),
    ):
        done = in_this_process(ronna_sim, *MOVE, *control)
        assert done.returncode != 0
        assert one_error(done.stderr)[0].startswith(code)
    assert ShiftedRoom(world).now() is NOTHING_MOVED


@pytest.mark.parametrize("known", ["a" * 32, "b" * 32, ""])
def test_a_case_is_asked_in_words_only_with_the_control_port_of_its_own_theatre(
    known: str, world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = ControlPort(ControlledRoom(world, tmp_path / "b", identity=known))
    monkeypatch.setenv("RONNA_CONTROL", port.endpoint)
    monkeypatch.setattr(request_checks, "on_terminal", lambda _stream: True)
    monkeypatch.setattr(request_checks, "is_simulated", lambda _theatre: True)
    theatre = SimpleNamespace(identity="a" * 32)
    monkeypatch.setattr(request_checks, "read_theatre_file", lambda _path: theatre)
    request = cast(RunRequest, SimpleNamespace(ask=True, config=tmp_path / "a" / "theatre.toml"))
    try:
        if known == theatre.identity:
            request_checks.check_asking(request)
            return
        with raises(CONTROL_PORT_OF_ANOTHER) as refused:
            request_checks.check_asking(request)
        for named in ("a", "b"):
            assert str(tmp_path / named) in str(refused.value)
    finally:
        port.close()
