"""Cases of a tracker's driver behind an OpenIGTLink server, and a simulated server of that kind."""

from __future__ import annotations

import contextlib

from conformance.case import LINE_FAULTS, CaseList, check, refused
from conformance.device_under_test import DeviceUnderTest
from conformance.protocol import ProtocolCases
from conformance.tracker import disturbed_tracker, read_frames
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout, ProtocolError

NO_MESSAGE = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
CASES = CaseList()


@CASES.case(
    "O01", "a message with a wrong check sum is counted and never becomes a reading", needs=(LINE_FAULTS,)
)
def wrong_bits_cost_one_message(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        tracker.read_frame()
        line.flip_next()
        with contextlib.suppress(LinkTimeout):
            tracker.read_frame()
        tracker.read_frame()
        says = tracker.observe().says
        check(any(fact.name == "disturbed messages" for fact in says), "a count of disturbed messages", says)


@CASES.case("O02", "bytes of another protocol latch a fault that recover clears", needs=(LINE_FAULTS,))
def other_bytes_latch_a_fault(dut: DeviceUnderTest) -> None:
    with disturbed_tracker(dut) as (line, tracker):
        tracker.read_frame()
        line.inject(NO_MESSAGE)
        refused(lambda: [tracker.read_frame() for _ in range(3)], ProtocolError, "reading other bytes")
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
        tracker.recover("conformance suite")
        dut.bring_to(Lifecycle.ACTIVE, tracker).read_frame()


@CASES.case("O03", "no measurement is placed later than its arrival")
def stamps_are_placed_in_theatre_time(dut: DeviceUnderTest) -> None:
    for frame in read_frames(dut):
        measured_s, arrived_s = frame.stamp.measured_s, frame.stamp.theatre_time_s
        check(measured_s is None or measured_s <= arrived_s, "no later than on arrival", frame.stamp)


PROTOCOL = ProtocolCases(
    cases=tuple(CASES.cases), simulator=lambda: ("polaris", "--endpoint", "igtl://127.0.0.1:0")
)
