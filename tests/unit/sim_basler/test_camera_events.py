"""Events of one camera on its message channel: sent, repeated and lost."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from ronna_hw.wire.gige_vision import Bootstrap
from sim.basler.faults import NoFaults
from sim.basler.message_channel import EVENTS_KEPT, EVENTS_PER_MESSAGE, CameraEvent, MessageChannel
from sim.basler.settings import EventKind

OK, INVALID_PARAMETER, ACCESS_DENIED = 0, 0x8002, 0x8006
OTHER = ("127.0.0.1", 40002)
EVENT, EVENTDATA = 0xC0, 0xC2
LIMIT_S = 30.0
TIMEOUT_MS = 200


class Message(NamedTuple):
    """One message as it came: flags, command, request id, and its items as (id, block, ticks)."""

    flags: int
    command: int
    request_id: int
    items: list[tuple[int, int, int]]
    data: bytes


class Listener:
    """The application's end of a message channel."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(LIMIT_S)
        self.port = int(self.socket.getsockname()[1])

    def message(self) -> Message:
        datagram, self.sender = self.socket.recvfrom(2048)
        key, flags, command, length, request_id = struct.unpack_from(">BBHHH", datagram)
        assert (key, length) == (0x42, len(datagram) - 8)
        size = length if command == EVENTDATA else 16
        items = []
        for start in range(8, len(datagram), size):
            reserved, kind, channel, block, ticks = struct.unpack_from(">HHHHQ", datagram, start)
            assert (reserved, channel) == (0, 0)
            items.append((kind, block, ticks))
        return Message(flags, command, request_id, items, datagram[24:] if command == EVENTDATA else b"")

    def acknowledge(self, message: Message) -> None:
        answer = struct.pack(">HHHH", 0, message.command + 1, 0, message.request_id)
        self.socket.sendto(answer, self.sender)

    def taken(self, channel: MessageChannel) -> Message:
        """The next message, acknowledged to the channel that sent it."""
        message = self.message()
        self.acknowledge(message)
        channel.receive()
        return message

    def nothing(self) -> bool:
        """True when nothing has come. Messages go out in the call that causes them, on loopback at once."""
        self.socket.settimeout(0.0)
        try:
            self.socket.recv(2048)
        except BlockingIOError:
            return True
        finally:
            self.socket.settimeout(LIMIT_S)
        return False


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.socket.close()


def subscribe(bench: Any, listener: Listener, *kinds: EventKind) -> None:
    """As a client does: control, where messages go, what is to be told."""
    bench.stream()
    assert bench.write(Bootstrap.MCDA, 0x7F000001) == OK
    assert bench.write(Bootstrap.MCTT_MS, TIMEOUT_MS) == OK
    assert bench.write(Bootstrap.MCRC, 2) == OK
    assert bench.write(Bootstrap.MCP, listener.port) == OK
    for kind in kinds:
        bench.put(EventSelector=int(kind), EventNotification=1)


def test_the_message_channel_belongs_to_the_client_in_control(bench: Any) -> None:
    assert bench.write(Bootstrap.MCP, 5000) == ACCESS_DENIED
    bench.take_control()
    assert bench.write(Bootstrap.MCP, 5000) == OK
    assert bench.write(Bootstrap.MCP, 6000, peer=OTHER) == ACCESS_DENIED
    assert bench.read(Bootstrap.MCP) == 5000
    assert bench.write(Bootstrap.CCP, 0) == OK
    assert bench.read(Bootstrap.MCP) == 0


def test_a_timeout_or_retry_count_out_of_range_is_refused(bench: Any) -> None:
    bench.take_control()
    assert bench.write(Bootstrap.MCTT_MS, 60_001) == INVALID_PARAMETER
    assert bench.write(Bootstrap.MCRC, 101) == INVALID_PARAMETER


def test_the_client_in_control_can_be_read(bench: Any) -> None:
    assert bench.read(Bootstrap.PRIMARY_APPLICATION_PORT) == 0
    bench.take_control()
    assert bench.read(Bootstrap.PRIMARY_APPLICATION_PORT, peer=OTHER) == 40001
    assert bench.read(Bootstrap.PRIMARY_APPLICATION_ADDRESS, peer=OTHER) == 0x7F000001


def test_the_end_of_an_exposure_is_reported_with_its_frame_and_time(bench: Any, listener: Listener) -> None:
    subscribe(bench, listener, EventKind.EXPOSURE_END)
    bench.put(TriggerMode=1, AcquisitionStart=1)
    exposure_us = bench.get("ExposureTimeRaw")
    for number in (1, 2):
        moment_ns = bench.clock.time_ns
        bench.put(TriggerSoftware=1)
        message = listener.message()
        ticks = (moment_ns + exposure_us * 1000) // 8
        assert (message.command, message.flags) == (EVENTDATA, 1)
        assert message.items == [(EventKind.EXPOSURE_END, number, ticks)]
        assert message.data == struct.pack(">I", number)
        assert listener.sender == ("127.0.0.1", bench.camera.messages.source_port)
        bench.frame()
        listener.acknowledge(message)
        bench.camera.messages.receive()


def test_a_trigger_that_comes_too_early_is_reported(bench: Any, listener: Listener) -> None:
    subscribe(bench, listener, EventKind.FRAME_START_OVERTRIGGER)
    bench.put(TriggerMode=1, AcquisitionStart=1)
    bench.images.gate.clear()
    moment_ns = bench.clock.time_ns
    for _ in range(3):
        bench.put(TriggerSoftware=1)
    # one exposes, the next is refused
    message = listener.message()
    assert message.command == EVENT
    assert message.items == [(EventKind.FRAME_START_OVERTRIGGER, 0, moment_ns // 8)]
    assert bench.get("OvertriggerCount") == 2


def test_acquisition_and_frame_triggers_are_reported_whether_obeyed_or_not(
    bench: Any, listener: Listener
) -> None:
    subscribe(
        bench,
        listener,
        EventKind.ACQUISITION_START,
        EventKind.ACQUISITION_START_OVERTRIGGER,
        EventKind.FRAME_START,
    )
    bench.put(TriggerSelector=0, TriggerMode=1, AcquisitionStart=1)
    bench.images.gate.clear()
    bench.put(TriggerMode=1, TriggerSelector=1)
    bench.put(TriggerMode=1)
    for selector in (0, 0, 1):
        bench.put(TriggerSelector=selector, TriggerSoftware=1)
    said: list[int] = []
    while len(said) < 3:
        said += [item[0] for item in listener.taken(bench.camera.messages).items]
    assert said == [
        EventKind.ACQUISITION_START,
        EventKind.ACQUISITION_START_OVERTRIGGER,
        EventKind.FRAME_START,
    ]


def test_only_enabled_events_are_sent(bench: Any, listener: Listener) -> None:
    subscribe(bench, listener, EventKind.EXPOSURE_END)
    bench.put(EventNotification=0)
    bench.put(TriggerMode=1, AcquisitionStart=1)
    bench.shoot()
    assert listener.nothing()
    assert bench.get("EventNotification") == 0


def test_a_free_running_camera_reports_its_exposures_too(bench: Any, listener: Listener) -> None:
    subscribe(bench, listener, EventKind.EXPOSURE_END)
    bench.put(AcquisitionStart=1)
    assert listener.message().items[0][:2] == (EventKind.EXPOSURE_END, 1)


def test_nothing_is_sent_after_control_is_released(bench: Any, listener: Listener) -> None:
    subscribe(bench, listener, EventKind.FRAME_START_OVERTRIGGER)
    assert bench.write(Bootstrap.CCP, 0) == OK
    assert bench.camera.messages.receiver is None
    assert bench.camera.messages.report(CameraEvent(EventKind.FRAME_START, 0, 1))
    assert listener.nothing()


class Channel:
    """A message channel alone, on a clock that is moved by hand."""

    def __init__(self, listener: Listener, faults: NoFaults | None = None) -> None:
        self.now_s = 0.0
        self.listener = listener
        self.channel = MessageChannel(
            "127.0.0.1", lambda: "127.0.0.1", lambda: self.now_s, faults or NoFaults()
        )
        self.channel.port = listener.port
        self.channel.timeout_ms, self.channel.retries = TIMEOUT_MS, 2

    def tell(self, kind: EventKind = EventKind.FRAME_START, block: int = 0, data: bytes = b"") -> bool:
        return self.channel.report(CameraEvent(kind, block, 8, data))

    def later(self, seconds: float) -> None:
        self.now_s += seconds
        self.channel.repeat_overdue()


@pytest.fixture
def channel(listener: Listener) -> Iterator[Channel]:
    made = Channel(listener)
    yield made
    made.channel.close()


def test_an_unacknowledged_message_is_repeated_and_then_given_up(channel: Channel) -> None:
    channel.tell(block=1)
    channel.tell(block=2)
    first = channel.listener.message()
    channel.later(0.19)
    assert channel.listener.nothing()
    for _ in range(2):
        channel.later(0.2)
        assert channel.listener.message() == first
    channel.later(0.2)
    assert channel.channel.unacknowledged == 1
    following = channel.listener.message()
    assert following.request_id == first.request_id + 1
    assert [item[1] for item in following.items] == [2]


def test_an_acknowledge_ends_the_repeats_and_releases_the_next_message(channel: Channel) -> None:
    channel.tell(block=1)
    for block in (2, 3):
        channel.tell(block=block)
    first = channel.listener.message()
    assert channel.listener.nothing()
    channel.listener.acknowledge(first._replace(request_id=first.request_id + 5))  # of another message
    channel.channel.receive()
    assert channel.listener.nothing()
    channel.listener.acknowledge(first)
    channel.channel.receive()
    assert [item[1] for item in channel.listener.taken(channel.channel).items] == [2, 3]
    assert channel.channel.due_s() is None


def test_an_acknowledge_from_another_host_ends_nothing(channel: Channel) -> None:
    channel.tell(block=1)
    first = channel.listener.message()
    answer = struct.pack(">HHHH", 0, first.command + 1, 0, first.request_id)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.2", 0))
        stranger.sendto(answer, channel.listener.sender)
    channel.channel.receive()
    channel.later(0.2)
    assert channel.listener.message() == first


def test_no_acknowledge_is_requested_without_a_timeout(channel: Channel) -> None:
    channel.channel.timeout_ms = 0
    for block in (1, 2):
        channel.tell(block=block)
        message = channel.listener.message()
        assert (message.flags, message.items[0][1]) == (0, block)


def test_an_event_with_data_is_sent_alone(channel: Channel) -> None:
    channel.tell(block=1)
    for block, data in ((2, b""), (3, b"abcd"), (4, b"")):
        channel.tell(block=block, data=data)
    found = []
    for _ in range(4):
        message = channel.listener.taken(channel.channel)
        found.append((message.command, [item[1] for item in message.items], message.data))
    assert found == [(EVENT, [1], b""), (EVENT, [2], b""), (EVENTDATA, [3], b"abcd"), (EVENT, [4], b"")]


def test_the_events_of_one_message_fit_the_datagram_limit() -> None:
    assert EVENTS_PER_MESSAGE * 16 <= 540 < (EVENTS_PER_MESSAGE + 1) * 16


@pytest.mark.parametrize("overruns", [True, False])
def test_excess_events_are_lost_and_at_most_one_overrun_event_reports_it(
    bench: Any, listener: Listener, overruns: bool
) -> None:
    kinds = [EventKind.FRAME_START_OVERTRIGGER] + [EventKind.EVENT_OVERRUN] * overruns
    subscribe(bench, listener, *kinds)
    bench.put(TriggerMode=1, AcquisitionStart=1)
    bench.images.gate.clear()
    # one message under way, the queue behind it, and three that find it full
    for _ in range(2 + 1 + EVENTS_KEPT + 3):
        bench.put(TriggerSoftware=1)
    said: list[int] = []
    for _ in range(2 if EVENTS_KEPT < EVENTS_PER_MESSAGE else 3):
        said += [item[0] for item in listener.taken(bench.camera.messages).items]
    assert said.count(EventKind.FRAME_START_OVERTRIGGER) == 1 + EVENTS_KEPT
    assert said.count(EventKind.EVENT_OVERRUN) == overruns


class LosesFirst(NoFaults):
    """The first message is lost."""

    def __init__(self) -> None:
        super().__init__()
        self.messages = 0

    def draw_message_loss(self) -> bool:
        self.messages += 1
        return self.messages == 1


def test_a_message_lost_on_the_network_is_sent_again(listener: Listener) -> None:
    channel = Channel(listener, LosesFirst())
    channel.tell(block=7)
    assert listener.nothing()
    channel.later(0.2)
    assert listener.message().items == [(EventKind.FRAME_START, 7, 8)]
    channel.channel.close()
