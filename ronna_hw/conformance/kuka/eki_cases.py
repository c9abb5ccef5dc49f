"""Cases for a KUKA controller on EKI, bypassing the driver: our channel and that of the C++ SDK.

The number of a case is K and a line of the protocol's checklist.
"""

from __future__ import annotations

import itertools
import re
import time
from xml.etree.ElementTree import Element

from ronna_hw.conformance.case import LIVE_FAULTS, MOTION, CaseList, check
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.kuka.eki_client import EkiLine, command
from ronna_hw.conformance.kuka.rsi_client import HOLD, RsiLine, eki_line, stream
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.wire.kuka_eki import RsiState

SDK = "eki"
PADDED_BYTES = 500  # length of every request of the SDK
QUIET_S = 0.15  # a controller that has sent nothing for so long sends nothing
BETWEEN_SPLITS_S = 0.03
LIMIT_S = 4.0
CYCLES = 50
STEP_DEG = 0.0025  # of A6 per cycle: tiny, but visible within a few cycles
WATCHED = 20  # cycles to tell an arm at rest from a moving one
BRAKING = 50  # cycles, generous for an arm that hardly moves
STANDS_STILL_DEG = 0.001
REPORTED_WITHIN = 1000  # cycles
STATE_CYCLES, LEAST_STATES = 100, 3  # one comes every 100 ms: at 4 ms every 25 cycles
MOST_OLD_STATES = 2
# What stops the arm, and how the state reports it.
STOPS = (
    ("emergency stop", "EStop", "1"),
    ("guard open", "Guard", "1"),
    ("mode T1", "Mode", "T1"),
    ("drives off", "Drives", "0"),
)
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


@case("K39b", "a change is reported to the SDK's client once, unsolicited", needs=(LIVE_FAULTS,))
def status_on_change(dut: DeviceUnderTest) -> None:
    with eki_line(dut, SDK) as line:
        line.send(request(CONNECT))
        _statuses(line)
        try:
            dut.fault("now: robot guard open")
            opened = [status.get("GuardStop") for status in _statuses(line)]
        finally:
            dut.clear_faults()
        closed = [status.get("GuardStop") for status in _statuses(line)]
    check((opened, closed) == (["1"], ["0"]), "one status for each change", f"{opened}, then {closed}")


@case("K40", "the stream outlives a lost connection, and the state still reports it")
def connection_is_lost(dut: DeviceUnderTest) -> None:
    with stream(dut) as line:
        line.cycles(5)
        line.eki.reconnect()
        line.cycles(CYCLES)
        check(line.eki.state().get("RSI") == "2", "RSI still in MOVECORR after a new connection")


@case(
    "K42",
    "emergency stop, guard, mode and drives show in the next state and stop RSI's motion",
    needs=(MOTION, LIVE_FAULTS),
)
def stops_are_reported(dut: DeviceUnderTest) -> None:
    for sign, (fault, attribute, value) in zip(itertools.cycle((1, -1)), STOPS, strict=False):
        with stream(dut) as line:
            line.eki.already("State")
            line.cycles(STATE_CYCLES)
            states = line.eki.already("State")
            check(len(states) >= LEAST_STATES, f"{LEAST_STATES} states in {STATE_CYCLES} cycles", len(states))
            try:
                dut.fault(f"now: robot {fault}")
                _require_reported(line, attribute, value, sign * STEP_DEG)
                state = line.eki.state()
            finally:
                dut.clear_faults()
        ends = (RsiState.ON, RsiState.FAULT)
        check(int(state.get("RSI", -1)) in ends, f"no corrections with {fault}", state.get("RSI"))


def _require_reported(line: RsiLine, attribute: str, value: str, step_deg: float) -> None:
    """Turn A6 evenly until the state reports `value`, and go on: the arm must come to rest anyway."""
    seen = [state.get(attribute) for state in line.eki.already("State")][-1:]  # the fault is active by now
    angles: list[float] = []
    ends_at = REPORTED_WITHIN
    for cycle in itertools.count(1):
        telegram = line.next_if_any()
        if telegram is None or cycle > ends_at:
            break
        line.answer(telegram, {**HOLD, "A6": cycle * step_deg})
        angles.append(telegram.values("AIPos")["A6"])
        seen += [state.get(attribute) for state in line.eki.already("State")]
        if value in seen:
            ends_at = min(ends_at, cycle + BRAKING + WATCHED)
    check(value in seen, f"{attribute} {value} in the state", seen[-1:] or "no state")
    # One may have been on its way, and one due before the controller noticed.
    old = seen.index(value)
    check(old <= MOST_OLD_STATES, f"{attribute} {value} in the next state", f"{old} others before it")
    moved = max(abs(angle - angles[-1]) for angle in angles[-WATCHED:])
    check(moved < STANDS_STILL_DEG, "an arm at rest", f"{moved:.5f} deg of motion")


def project_channel(dut: DeviceUnderTest) -> Endpoint:
    """The endpoint of our own channel."""
    return parse_endpoint(dut.config.endpoints["eki_project"])


def _answered(line: EkiLine, identifier: str) -> None:
    until_s = time.monotonic() + LIMIT_S
    while time.monotonic() < until_s:
        if line.element("State")[1].get("Id") == identifier:
            return
    check(False, f"an answer to {identifier}")


def _statuses(line: EkiLine) -> list[Element]:
    """The next status, and those that follow it closely."""
    found = [line.element("Robot", limit_s=LIMIT_S)[1].find("Status")]
    until_s = time.monotonic() + QUIET_S
    while time.monotonic() < until_s:
        time.sleep(BETWEEN_SPLITS_S)
        found += [root.find("Status") for root in line.already("Robot")]
    return [status for status in found if status is not None]


def _response(line: EkiLine, event: str) -> tuple[bytes, Element]:
    """The next response, which must have that event."""
    while True:
        raw, root = line.element("Robot", limit_s=LIMIT_S)
        found = root.find("Response")
        if found is not None:
            check(found.get("EventID") == event, f"event {event}", found.get("EventID"))
            return raw, root
