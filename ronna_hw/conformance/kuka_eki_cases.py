"""What a KUKA controller must do on EKI, past the driver: the project's channel and that of the C++ SDK.

The number of a case is K and a line of the protocol's checklist.
"""

from __future__ import annotations

import re
import time
from xml.etree.ElementTree import Element

from ronna_hw.conformance.bench import Bench
from ronna_hw.conformance.case import Suite, check
from ronna_hw.conformance.kuka_eki_line import EkiLine, command
from ronna_hw.conformance.kuka_rsi_line import eki_line, stream
from ronna_hw.endpoints import Endpoint, parse_endpoint

SDK = "eki"
PADDED_BYTES = 500  # every request of the SDK has this length, whatever it says
QUIET_S = 0.15  # after which a controller that wants to say nothing has said nothing
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

KUKA_EKI = Suite("kuka eki", driver="kuka_rsi", simulator=())
case = KUKA_EKI.case


def request(kind: int) -> bytes:
    """A request of the SDK, padded with NUL as that client pads it."""
    text = f'<External REQTYPE="{kind}" CycleTime="1" ControlMode="1"></External>'
    return text.encode().ljust(PADDED_BYTES, b"\0")


@case("K34", "one client per channel; nothing but elements is written")
def one_client(bench: Bench) -> None:
    with eki_line(bench) as first:
        first.state()
        with EkiLine(bench_address(bench)) as second:
            second.command("STATUS")
            check(second.hung_up_on(), "a second client that is refused")
        first.state()
        check(first.between == b"", "no byte between elements", first.between)


@case("K35", "requests are understood padded with NUL, in pieces, and several at once")
def requests_by_element_end(bench: Bench) -> None:
    with eki_line(bench) as line:
        line.send(command("padded", "STATUS").ljust(PADDED_BYTES, b"\0"))
        _answered(line, "padded")
        for piece in (b'<Cmd Id="pie', b'ces" Name="STA', b'TUS"></Cmd>'):
            line.send(piece)
            time.sleep(BETWEEN_SPLITS_S)
        _answered(line, "pieces")
        line.send(command("one", "STATUS") + command("two", "STATUS"))
        _answered(line, "one")
        _answered(line, "two")


@case("K36", "elements have end tags of their own; Status and Init have their attributes in the SDK's order")
def sdk_layout(bench: Bench) -> None:
    with eki_line(bench, SDK) as line:
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
        check(not numbers, "whole numbers", numbers)


@case("K37", "what does not fit the state is answered by event 7, in time")
def invalid_request(bench: Bench) -> None:
    with eki_line(bench, SDK) as line:
        line.send(request(CONNECT))
        _response(line, EVENT_CONNECTED)
        line.send(request(START))  # not before a control mode is chosen
        _response(line, EVENT_INVALID)


@case("K39", "the SDK's client is told the status once, unasked, and not again while nothing changes")
def status_once(bench: Bench) -> None:
    with eki_line(bench, SDK) as line:
        told = 0
        until_s = time.monotonic() + 4 * QUIET_S
        line.send(request(CONNECT))
        while time.monotonic() < until_s:
            try:
                _, root = line.element("Robot", limit_s=QUIET_S)
            except AssertionError:  # quiet
                continue
            told += root.find("Status") is not None and root.find("Response") is None
        check(told <= 1, "at most one unasked status", told)


@case("K40", "losing the conversation ends neither the stream nor the truth about it")
def conversation_is_lost(bench: Bench) -> None:
    with stream(bench) as line:
        line.cycles(5)
        line.eki.begin_anew()
        line.cycles(CYCLES)
        check(line.eki.state().get("RSI") == "2", "RSI still in MOVECORR after a new connection")


def bench_address(bench: Bench) -> Endpoint:
    """The project's channel."""
    return parse_endpoint(bench.config.endpoints["eki_project"])


def _answered(line: EkiLine, identifier: str) -> None:
    until_s = time.monotonic() + LIMIT_S
    while time.monotonic() < until_s:
        if line.element("State")[1].get("Id") == identifier:
            return
    check(False, f"an answer to {identifier}")


def _response(line: EkiLine, event: str) -> tuple[bytes, Element]:
    """The next response; it must tell that event."""
    while True:
        raw, root = line.element("Robot", limit_s=LIMIT_S)
        found = root.find("Response")
        if found is not None:
            check(found.get("EventID") == event, f"event {event}", found.get("EventID"))
            return raw, root
