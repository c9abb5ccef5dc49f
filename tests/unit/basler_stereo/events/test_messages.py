"""Messages with events: what is one, what is counted, and under which ids a camera reports."""

from __future__ import annotations

import random
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from drivers.basler_stereo.events.listener import EventListener
from drivers.basler_stereo.events.messages import EventCounters, decode_message, event_ids
from drivers.basler_stereo.features.description import parse_description

EVENT, EVENTDATA = 0xC0, 0xC2
LIMIT_S = 30.0
NAMES = {0x9001: "ExposureEnd", 0x9002: "FrameStartOvertrigger", 0x9006: "EventOverrun"}
DESCRIPTION = b"""<RegisterDescription>
 <Integer Name="ExposureEndEventTimestamp"><pValue>Stamp</pValue></Integer>
 <IntReg Name="Stamp"><Address>8</Address><Length>8</Length><pPort>ExposurePort</pPort></IntReg>
 <Port Name="ExposurePort"><EventID>9abc</EventID></Port>
 <IntReg Name="EventOverrunEventTimestamp"><Address>8</Address><pPort>OverrunPort</pPort></IntReg>
 <Port Name="OverrunPort"><EventID>9001</EventID></Port>
 <Integer Name="FrameStartOvertriggerEventTimestamp"><pValue>Nowhere</pValue></Integer>
</RegisterDescription>"""


def item(event_id: int, block: int = 0, ticks: int = 0) -> bytes:
    return struct.pack(">HHHHQ", 0, event_id, 0, block, ticks)


def message(command: int, payload: bytes, request_id: int = 1, flags: int = 1) -> bytes:
    return struct.pack(">BBHHH", 0x42, flags, command, len(payload), request_id) + payload


def test_a_message_may_hold_several_events() -> None:
    found = decode_message(message(EVENT, item(0x9001, 7, 1 << 40) + item(0x9002, 0, 9), 5))
    assert found is not None
    assert found.items == ((0x9001, 7, 1 << 40), (0x9002, 0, 9))
    assert found.wants_acknowledge
    assert found.acknowledge() == bytes.fromhex("0000 00c1 0000 0005")


def test_an_event_with_data_is_one_event() -> None:
    found = decode_message(message(EVENTDATA, item(0x9001, 3, 4) + b"\0\0\0\3", flags=0))
    assert found is not None
    assert found.items == ((0x9001, 3, 4),)
    assert not found.wants_acknowledge
    assert found.acknowledge()[2:4] == b"\x00\xc3"


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        message(EVENT, b""),
        message(EVENT, item(1) + b"half"),
        message(EVENT, item(1))[:-1],
        message(0x82, item(1)),
        message(EVENT, item(1), flags=0x11),
        b"\x43" + message(EVENT, item(1))[1:],
    ],
    ids=["empty", "no event", "half an event", "cut off", "a command", "64-bit ids", "another key"],
)
def test_anything_else_is_no_message(datagram: bytes) -> None:
    assert decode_message(datagram) is None


def test_no_bytes_whatever_upset_the_decoder() -> None:
    chance = random.Random(3)
    for _ in range(20_000):
        size = chance.randrange(0, 40)
        head = struct.pack(">BBHHH", 0x42, chance.getrandbits(8), chance.choice((EVENT, EVENTDATA)), size, 1)
        found = decode_message(head + chance.randbytes(size))
        assert found is None or 1 <= len(found.items) <= 2


def test_events_are_counted_by_what_they_tell() -> None:
    counters = EventCounters()
    for name in ("ExposureEnd", "FrameStartOvertrigger", "AcquisitionStartOvertrigger", "EventOverrun", None):
        counters.count(name)
    assert counters == EventCounters(exposures=1, missed_triggers=2, overruns=1, others=1)


def test_the_ids_are_those_of_the_description() -> None:
    assert event_ids(parse_description(DESCRIPTION)) == {0x9ABC: "ExposureEnd", 0x9001: "EventOverrun"}


class CameraEnd:
    """Where messages come from."""

    def __init__(self, listener: EventListener) -> None:
        self.listener = listener
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(LIMIT_S)

    def say(self, datagram: bytes) -> bytes:
        """Send a message and return what comes back."""
        self.socket.sendto(datagram, self.listener.address)
        return self.socket.recv(100)


@pytest.fixture
def camera_end() -> Iterator[CameraEnd]:
    listener = EventListener("127.0.0.1", "127.0.0.1", NAMES, "left")
    made = CameraEnd(listener)
    yield made
    made.socket.close()
    listener.close()


def counted(camera_end: CameraEnd, wanted: EventCounters) -> bool:
    """The acknowledge goes out before the counting; so the counts are awaited."""
    deadline_s = time.monotonic() + LIMIT_S
    while camera_end.listener.counters != wanted and time.monotonic() < deadline_s:
        time.sleep(0.001)
    return camera_end.listener.counters == wanted


def test_a_message_is_acknowledged_each_time_and_counted_once(camera_end: CameraEnd) -> None:
    missed = message(EVENT, item(0x9002), request_id=9)
    for _ in range(3):
        assert camera_end.say(missed) == bytes.fromhex("0000 00c1 0000 0009")
    assert counted(camera_end, EventCounters(missed_triggers=1, repeated_messages=2))
    camera_end.say(message(EVENT, item(0x9002), request_id=10))
    assert counted(camera_end, EventCounters(missed_triggers=2, repeated_messages=2))


def test_messages_of_strangers_and_rubbish_are_left_alone(camera_end: CameraEnd) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.9", 0))
        stranger.sendto(message(EVENT, item(0x9002)), camera_end.listener.address)
    camera_end.socket.sendto(b"rubbish", camera_end.listener.address)
    camera_end.say(message(EVENT, item(0x9001), request_id=2))
    assert counted(camera_end, EventCounters(exposures=1))
