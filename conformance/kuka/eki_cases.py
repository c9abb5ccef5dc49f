"""Cases for the EKI channel of a KUKA controller, bypassing the driver.

The number of a case is K and a line of the protocol's checklist.
"""

from __future__ import annotations

import time

from conformance.case import CaseList, check
from conformance.device_under_test import DeviceUnderTest
from conformance.kuka.eki_client import EkiLine, command
from conformance.kuka.rsi_client import eki_line, stream

PADDED_BYTES = 500  # as the C++ SDK pads every request
BETWEEN_SPLITS_S = 0.03
CYCLES = 50

CASES = CaseList()
case = CASES.case


@case("K34", "one client per channel; nothing is written between elements")
def one_client(dut: DeviceUnderTest) -> None:
    with eki_line(dut) as first:
        first.state()
        with EkiLine(first.endpoint) as second:
            second.command("STATUS")
            check(second.closed_by_controller(), "a second client that is refused")
        first.state()
        check(first.between == b"", "no byte between elements", first.between)


@case("K35", "requests may be padded with NUL, split, or sent several at once")
def requests_by_element_end(dut: DeviceUnderTest) -> None:
    with eki_line(dut) as line:
        line.send(command("padded", "STATUS").ljust(PADDED_BYTES, b"\0"))
        line.answer("State", "padded")
        for piece in (b'<Cmd Id="pie', b'ces" Name="STA', b'TUS"></Cmd>'):
            line.send(piece)
            time.sleep(BETWEEN_SPLITS_S)
        line.answer("State", "pieces")
        line.send(command("one", "STATUS") + command("two", "STATUS"))
        line.answer("State", "one")
        line.answer("State", "two")


@case("K40", "the stream outlives a lost connection, and the state still reports it")
def connection_is_lost(dut: DeviceUnderTest) -> None:
    with stream(dut) as line:
        line.cycles(5)
        line.eki.reconnect()
        line.cycles(CYCLES)
        check(line.eki.state().get("RSI") == "2", "RSI still in MOVECORR after a new connection")
