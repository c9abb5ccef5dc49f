"""Operator mistakes and mishaps: each has its code and says what happened and what to do."""

from __future__ import annotations

import errno
import os
import pty
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import serial
from polaris_unit_in_process import bring_up, configured

from drivers.ndi_polaris import PolarisTracker, errors
from drivers.ndi_polaris.shipped_tools import build_shipped_definitions
from drivers.ndi_polaris.tool_definition import definition_hash, encode_definition
from drivers.ndi_polaris.transport import SerialTransport
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, RonnaError

ROBOT_FRAME = build_shipped_definitions()["robot_frame.rom"]
Make = Callable[..., PolarisTracker]


@contextmanager
def raises_on_one_line(code: str, message: str, action: str) -> Iterator[pytest.ExceptionInfo[RonnaError]]:
    """Expect an error of ours with that code, those words and that advice, on one line."""
    with pytest.raises(RonnaError) as caught:
        yield caught
    assert caught.value.code == code
    assert re.search(message, caught.value.what, re.IGNORECASE), caught.value.what
    assert re.search(action, caught.value.advice, re.IGNORECASE), caught.value.advice
    assert "\n" not in str(caught.value)


def tracker_at(endpoint: str, **options: Any) -> PolarisTracker:
    options.setdefault("tools", [{"name": "robot_frame", "rom": "robot_frame.rom"}])
    config = DeviceConfig(driver="ndi_polaris", endpoint=endpoint, options=options)
    return PolarisTracker("tracker", config, HostClock())


# --- the port -------------------------------------------------------------------------------------------


def test_a_wrong_port_is_refused_with_the_reason(tmp_path: Path) -> None:
    with raises_on_one_line("NDI-001", "no such file", "name of the port.*doctor"):
        tracker_at(f"serial://{tmp_path}/ttyUSB7").connect(1.0)
    with raises_on_one_line("NDI-001", "not a serial port", "not a serial port.*doctor"):
        tracker_at("serial:///dev/null").connect(1.0)
    device = tracker_at("tcp://127.0.0.1:1")
    with raises_on_one_line("NDI-001", "refused", "nothing listens.*address and port") as caught:
        device.connect(1.0)
    assert caught.value.exit_code == EXIT_NOT_FOUND
    device.close()
    assert device.state is Lifecycle.CLOSED


def test_an_unknown_host_name_is_reported() -> None:
    with raises_on_one_line("NDI-001", "cannot open tcp://no.such.host.invalid", "address"):
        tracker_at("tcp://no.such.host.invalid:8765").connect(1.0)


def test_a_missing_permission_is_reported_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:  # the administrator may open everything, so the port is told to
        raise serial.SerialException(errno.EACCES, "could not open port /dev/ttyUSB0")

    monkeypatch.setattr(serial, "Serial", refuse)
    with raises_on_one_line("NDI-001", "permission denied", "group that owns the port.*log in again"):
        tracker_at("serial:///dev/ttyUSB0").connect(1.0)


@pytest.mark.hazard(34)
def test_a_port_held_by_another_program_is_reported() -> None:
    unit, terminal = pty.openpty()
    endpoint = f"serial://{os.ttyname(terminal)}"
    first = SerialTransport(parse_endpoint(endpoint))
    with raises_on_one_line("NDI-001", "held by another program", "stop it"):
        tracker_at(endpoint).connect(1.0)
    first.close()
    os.close(unit)
    os.close(terminal)


# --- who answers ----------------------------------------------------------------------------------------


def test_a_silent_unit_is_reported_with_the_rates_tried(make_tracker: Make, unit: Any) -> None:
    unit.silent, unit.breaks_work = True, False
    device = make_tracker()
    with raises_on_one_line(
        "NDI-002", "tried 9600 baud, 115200 baud, .*, 14400 baud, a break", "powered.*this is its port"
    ):
        device.connect(10.0)
    assert unit.now_s <= 10.1
    assert device.state is Lifecycle.DISCONNECTED


def test_a_time_limit_too_short_for_every_rate_names_the_rates_tried(make_tracker: Make, unit: Any) -> None:
    unit.silent = True
    with raises_on_one_line("NDI-002", "tried 9600 baud, 115200 baud, 921600 baud$", "powered"):
        make_tracker().connect(1.0)


def test_another_device_on_the_serial_port_is_reported(make_tracker: Make, unit: Any) -> None:
    unit.breaks_work = False
    unit.deliver = lambda name, reply: [(0.01, b"login: ")]
    with raises_on_one_line("NDI-003", "bytes without", "another device or program") as caught:
        make_tracker().connect()
    assert caught.value.wire


@contextmanager
def a_server(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """Run a program that is no unit, listening on the loopback address."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def run() -> None:
            connection = server.accept()[0]
            with connection:
                serve(connection)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        thread.join(30.0)
        assert not thread.is_alive()


def answer_everything(talk: bytes, connection: socket.socket) -> None:
    while connection.recv(4096):
        connection.sendall(talk)


def talk_for_ever(connection: socket.socket) -> None:
    try:
        while True:
            connection.sendall(b"tick tock " * 1000)
    except OSError:
        return  # the host has had enough


@pytest.mark.parametrize(
    ("serve", "code", "message", "advice"),
    [
        *(
            (partial(answer_everything, talk), "NDI-003", "CRC", "another device or program")
            for talk in (
                b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n",
                b"220 mail ready\r\n",
                b"\xff\xfb\x01\xff\xfb\x03",
                b"\xc4\xa5" + bytes(400),
            )
        ),
        (talk_for_ever, "NDI-003", "sends unsolicited data", "another device or program"),
        (socket.socket.close, "NDI-008", "closed|broke", "power and cable"),
    ],
    ids=["http", "mail", "telnet", "bytes", "endless", "hangs up"],
)
def test_another_program_at_the_tcp_address_is_reported(
    serve: Callable[[socket.socket], None], code: str, message: str, advice: str
) -> None:
    with a_server(serve) as endpoint, raises_on_one_line(code, message, advice):
        tracker_at(endpoint).connect(30.0)


# --- the mode of the unit -------------------------------------------------------------------------------


def test_a_unit_left_tracking_by_an_earlier_program_is_taken_over(make_tracker: Make, unit: Any) -> None:
    unit.initialised = unit.tracking = True
    unit.handles[1] = {"occupied", "initialised", "enabled"}
    device = bring_up(make_tracker())
    assert [reading.tool for reading in device.read_frame().tools] == ["robot_frame"]


def test_a_unit_in_a_mode_that_cannot_track_refuses_activation(make_tracker: Make, unit: Any) -> None:
    device = configured(make_tracker())
    unit.answers_to["TSTART"] = unit.answers_to["TSTOP"] = "ERROR0C"  # diagnostic mode, by another host
    with raises_on_one_line("NDI-032", "TSTART.*mode", "another program"):
        device.activate()
    assert device.state is Lifecycle.CONFIGURED
    unit.answers_to.clear()
    device.activate()
    assert device.read_frame().tool("robot_frame").position_mm


# --- tool definitions -----------------------------------------------------------------------------------


CORRUPT = bytearray(encode_definition(ROBOT_FRAME))
CORRUPT[80] ^= 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (bytes(CORRUPT), "has a wrong checksum"),
        (b"", "has 0 bytes"),
        (b"PK\3\4" + bytes(748), "is not a tool definition"),
        (b"NDI\0" + bytes(100), "has 104 bytes"),
    ],
)
def test_an_invalid_definition_is_refused_before_the_line_is_opened(
    make_tracker: Make, unit: Any, tmp_path: Path, content: bytes, words: str
) -> None:
    (tmp_path / "bent.rom").write_bytes(content)
    with raises_on_one_line("NDI-011", f"bent.rom {words}", "of the tool"):
        make_tracker(tools=[{"name": "M", "rom": str(tmp_path / "bent.rom")}])
    assert unit.commands == []


@pytest.mark.hazard(17)
def test_a_valid_definition_of_another_tool_is_refused(
    make_tracker: Make, tmp_path: Path, pointer: Any
) -> None:
    (tmp_path / "tool.rom").write_bytes(encode_definition(pointer))
    meant = {"name": "M", "rom": str(tmp_path / "tool.rom"), "sha256": definition_hash(ROBOT_FRAME)}
    with raises_on_one_line(
        "NDI-013", "tool.rom is not the definition configured for tool M", "of this tool"
    ):
        make_tracker(tools=[meant])
    make_tracker(tools=[{**meant, "sha256": definition_hash(pointer)}])


def described(part_number: str, serial_number: str) -> str:
    """Return the answer to PHINF 0005 of a reference tool."""
    return f"01000000{'RONNA':12}000{serial_number}31{part_number:20}"


@pytest.mark.hazard(17)
def test_a_unit_that_holds_another_tool_than_was_sent_is_refused(make_tracker: Make, unit: Any) -> None:
    unit.override("PHINF", lambda argument: described("8700339", "34801403"))
    device = make_tracker()
    device.connect()
    with raises_on_one_line("NDI-013", "handle 01 holds another tool than robot_frame", "of this tool"):
        device.configure()


@pytest.mark.parametrize("step", [1, -1])
def test_either_byte_order_of_the_serial_number_is_accepted(make_tracker: Make, unit: Any, step: int) -> None:
    number = encode_definition(ROBOT_FRAME)[20:24][::step].hex().upper()
    unit.override("PHINF", lambda argument: described("RONNA-M", number))
    device = configured(make_tracker())
    assert device.notices == ()


def test_a_tool_reported_with_another_serial_number_is_noted(make_tracker: Make, unit: Any) -> None:
    unit.override("PHINF", lambda argument: described("RONNA-M", "00000000"))
    device = configured(make_tracker())
    assert any("serial number 00000000" in note for note in device.notices)


@pytest.mark.hazard(17)
def test_two_tools_with_the_same_geometry_are_refused(make_tracker: Make, tmp_path: Path) -> None:
    (tmp_path / "twin.rom").write_bytes(encode_definition(ROBOT_FRAME))
    tools = [{"name": "M", "rom": "robot_frame.rom"}, {"name": "twin", "rom": str(tmp_path / "twin.rom")}]
    with raises_on_one_line(
        "NDI-012", r"tools M \(robot_frame.rom\) and twin \(.*/twin.rom\)", "distances differ"
    ):
        make_tracker(tools=tools)


# --- in the middle of the work --------------------------------------------------------------------------


@pytest.mark.hazard(4)
@pytest.mark.parametrize("sent", [0, 1, 5, 6, 20, 52])
def test_a_link_that_dies_mid_reply_latches_a_fault_and_can_be_recovered(
    tracker: PolarisTracker, unit: Any, sent: int
) -> None:
    def dying(name: str, reply: bytes) -> list[tuple[float, bytes]]:
        unit.silent = True
        return [(0.001, reply[:sent])]

    unit.deliver = dying
    lost = 0
    while tracker.state is Lifecycle.ACTIVE:
        with pytest.raises((errors.MalformedReply, errors.NoReply, errors.LinkLost)):
            tracker.read_frame()
        lost += 1
    assert lost <= 7  # the unit may take four seconds, each reading waits for one
    assert isinstance(tracker.fault, errors.LinkLost)
    with raises_on_one_line("DEV-001", "not allowed now", "after a fault, acknowledge by name"):
        tracker.read_frame()
    assert tracker.state is Lifecycle.FAULT
    unit.silent = False
    unit.deliver = lambda name, reply: [(0.001, reply)]
    tracker.recover("tester")
    tracker.activate()
    assert tracker.read_frame().tool("robot_frame").position_mm


@pytest.mark.hazard(4)
def test_a_restarted_unit_is_reported_and_tracks_again_after_recovery(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.restart()
    unit.send_unasked(b"RESETBE6F\r")
    with raises_on_one_line("NDI-009", "sent RESET", "recover.*void"):
        tracker.read_frame()
    tracker.recover("tester")
    tracker.activate()
    assert tracker.read_frame().stamp.device_clock == 0


@pytest.mark.hazard(15)
def test_a_bump_from_before_the_session_is_reported_and_cleared_by_a_named_recovery(
    make_tracker: Make, unit: Any
) -> None:
    unit.parameters["Param.Bump Detector.Bumped"] = "1"
    device = make_tracker()
    device.connect()
    with raises_on_one_line("NDI-021", "bumped before this connection", "check the unit and its stand"):
        device.configure()
    assert device.state is Lifecycle.FAULT
    device.recover("tester")
    assert unit.parameters["Param.Bump Detector.Bumped"] == "0"
    assert device.state is Lifecycle.CONFIGURED


@pytest.mark.hazard(15)
def test_a_bump_found_while_recovering_from_another_fault_is_not_cleared_with_it(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.restart()
    unit.unit_baud = unit.baud
    with pytest.raises(errors.UnitRestarted):
        tracker.read_frame()
    unit.restart()
    unit.parameters["Param.Bump Detector.Bumped"] = "1"
    with raises_on_one_line("NDI-021", "bumped", "check the unit"):
        tracker.recover("tester")
    assert tracker.state is Lifecycle.FAULT
    assert unit.parameters["Param.Bump Detector.Bumped"] == "1"
    tracker.recover("tester")
    assert tracker.state is Lifecycle.CONFIGURED


@pytest.mark.hazard(15)
def test_a_persistent_hardware_fault_blocks_recovery(tracker: PolarisTracker, unit: Any) -> None:
    unit.system_status = 0x0010
    with raises_on_one_line("NDI-020", "hardware fault", "Power-cycle") as caught:
        tracker.read_frame()
    assert "0010" in str(caught.value)
    assert tracker.state is Lifecycle.FAULT
    unit.parameters["Info.Status.Alerts"] = str(1 << 4)
    with raises_on_one_line("NDI-020", "hardware fault", "Power-cycle"):
        tracker.recover("tester")
    assert tracker.state is Lifecycle.FAULT
    unit.parameters["Info.Status.Alerts"], unit.system_status = "0", 0
    tracker.recover("tester")
    tracker.activate()
    assert tracker.read_frame().tool("robot_frame").position_mm
