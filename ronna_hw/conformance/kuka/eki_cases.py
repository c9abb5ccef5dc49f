"""Cases for a KUKA controller on EKI, bypassing the driver: our channel and that of the C++ SDK.

The number of a case is K and a line of the protocol's checklist.
"""

from __future__ import annotations

import re
import time
from xml.etree.ElementTree import Element

from ronna_hw.conformance.case import CaseList, check
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.kuka.eki_client import EkiLine, command
from ronna_hw.conformance.kuka.rsi_client import eki_line, stream
from ronna_hw.endpoints import Endpoint, parse_endpoint

SDK = "eki"
PADDED_BYTES = 500  # length of every request of the SDK
QUIET_S = 0.15  # a controller that has sent nothing for so long sends nothing
BETWEEN_SPLITS_S = 0.03
LIMIT_S = 4.0
CYCLES = 50
CONNECT, START = 0, 1
EVENT_CONNECTED, EVENT_INVALID = "5", "7"
STATUS_ATTRIBUTES = [
    "ControlMode",
    "CycleTime",
    "DrivesPowered",
    "EmergencyStop",
    "GuardStop",
    "InMotion",
    "MotionPossible",
    "OperationMode",
    "RobotStopped",
]
INIT_ATTRIBUTES = ("VER", "NumAxes", "NumExternalAxes", "Model", "RobVer")

CASES = CaseList()
case = CASES.case


def request(kind: int) -> bytes:
    """A request of the SDK, padded with NUL as that client pads it."""
    text = f'<External REQTYPE="{kind}" CycleTime="1" ControlMode="1"></External>'
    return text.encode().ljust(PADDED_BYTES, b"\0")


@case("K34", "one client per channel; nothing is written between elements")
def one_client(dut: DeviceUnderTest) -> None:
    with eki_line(dut) as first:
        first.state()
        with EkiLine(project_channel(dut)) as second:
            second.command("STATUS")
            check(second.closed_by_controller(), "a second client that is refused")
        first.state()
        check(first.between == b"", "no byte between elements", first.between)


@case("K35", "requests may be padded with NUL, split, or sent several at once")
def requests_by_element_end(dut: DeviceUnderTest) -> None:
    with eki_line(dut) as line:
        line.send(command("padded", "STATUS").ljust(PADDED_BYTES, b"\0"))
        _answered(line, "padded")
        for piece in (b'<Cmd Id="pie', b'ces" Name="STA', b'TUS"></Cmd>'):
            line.send(piece)
            time.sleep(BETWEEN_SPLITS_S)
        _answered(line, "pieces")
        line.send(command("one", "STATUS") + command("two", "STATUS"))
        _answered(line, "one")
        _answered(line, "two")


@case("K36", "elements have separate end tags; attributes of Status and Init are in the SDK's order")
def sdk_layout(dut: DeviceUnderTest) -> None:
    with eki_line(dut, SDK) as line:
        line.send(request(CONNECT))
        raw, root = _response(line, EVENT_CONNECTED)
        check(b"/>" not in raw, "separate end tags", raw[:120])
        init = root.find("Init")
        check(init is not None and tuple(init.attrib) == INIT_ATTRIBUTES, " ".join(INIT_ATTRIBUTES), raw)
        status = root.find("Status")
        while status is None:
            status = line.element("Robot")[1].find("Status")
        check(list(status.attrib) == STATUS_ATTRIBUTES, " ".join(STATUS_ATTRIBUTES), list(status.attrib))
        numbers = [value for value in status.attrib.values() if re.fullmatch(r"-?\d+", value) is None]
        check(not numbers, "integers", numbers)


@case("K37", "a request that is invalid in the present state gets event 7, in time")
def invalid_request(dut: DeviceUnderTest) -> None:
    with eki_line(dut, SDK) as line:
        line.send(request(CONNECT))
        _response(line, EVENT_CONNECTED)
        line.send(request(START))  # invalid until a control mode is chosen
        _response(line, EVENT_INVALID)


@case("K39", "the SDK's client gets one unsolicited status, and no other until something changes")
def status_once(dut: DeviceUnderTest) -> None:
    with eki_line(dut, SDK) as line:
        statuses = 0
        until_s = time.monotonic() + 4 * QUIET_S
        line.send(request(CONNECT))
        while time.monotonic() < until_s:
            try:
                _, root = line.element("Robot", limit_s=QUIET_S)
            except AssertionError:  # quiet
                continue
            statuses += root.find("Status") is not None and root.find("Response") is None
        check(statuses <= 1, "at most one unsolicited status", statuses)


@case("K40", "the stream outlives a lost connection, and the state still reports it")
def connection_is_lost(dut: DeviceUnderTest) -> None:
    with stream(dut) as line:
        line.cycles(5)
        line.eki.reconnect()
        line.cycles(CYCLES)
        check(line.eki.state().get("RSI") == "2", "RSI still in MOVECORR after a new connection")


def project_channel(dut: DeviceUnderTest) -> Endpoint:
    """The endpoint of our own channel."""
    return parse_endpoint(dut.config.endpoints["eki_project"])


def _answered(line: EkiLine, identifier: str) -> None:
    until_s = time.monotonic() + LIMIT_S
    while time.monotonic() < until_s:
        if line.element("State")[1].get("Id") == identifier:
            return
    check(False, f"an answer to {identifier}")


def _response(line: EkiLine, event: str) -> tuple[bytes, Element]:
    """The next response, which must have that event."""
    while True:
        raw, root = line.element("Robot", limit_s=LIMIT_S)
        found = root.find("Response")
        if found is not None:
            check(found.get("EventID") == event, f"event {event}", found.get("EventID"))
            return raw, root
