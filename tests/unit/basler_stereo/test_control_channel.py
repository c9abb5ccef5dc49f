"""Commands are repeated, matched and refused; control is taken, kept by a heartbeat, and lost."""

from __future__ import annotations

import os
import socket
import struct
import threading
import time

import pytest
from coded_errors import raises

from drivers.basler_stereo import control_channel
from drivers.basler_stereo.control_channel import (
    SILENT_BEATS,
    CameraControl,
    Heartbeat,
    register_write,
    send_together,
    take_control,
)
from drivers.basler_stereo.errors import (
    BAD_DESCRIPTION,
    CameraLost,
    CommandRefused,
    ControlLost,
    ControlTaken,
    MalformedReply,
    NoReply,
)
from drivers.basler_stereo.features.description import fetch_description
from ronna_hw.devices.capabilities import Direction
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import CCP_CONTROL, CCP_OPEN, Bootstrap, GevStatus


class Answering:
    """UDP socket whose thread gives every datagram to a function and sends what that returns."""

    def __init__(self, answer) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.seen: list[bytes] = []
        self._answer = answer
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while True:
            datagram, peer = self.socket.recvfrom(65536)
            if datagram == b"end":
                return
            self.seen.append(datagram)
            for reply in self._answer(datagram, len(self.seen)):
                self.socket.sendto(reply, peer)

    def close(self) -> None:
        self.socket.sendto(b"end", self.socket.getsockname())
        self._thread.join()
        self.socket.close()


@pytest.fixture
def channel_to():
    opened = []

    def make(answer, **options):
        peer = Answering(answer)
        channel = CameraControl("127.0.0.1", port=peer.port, **options)
        opened.append((peer, channel))
        return peer, channel

    yield make
    for peer, channel in opened:
        channel.close()
        peer.close()


def ack(datagram: bytes, payload: bytes = b"", status: int = 0, command: int | None = None, shift: int = 0):
    _, _, asked, _, request_id = struct.unpack_from(">BBHHH", datagram)
    code = asked + 1 if command is None else command
    return struct.pack(">HHHH", status, code, len(payload), request_id + shift) + payload


def soon(limit_s: float = 5.0) -> float:
    return time.monotonic() + limit_s


def test_a_lost_answer_is_requested_again_with_the_same_request_id(channel_to):
    peer, channel = channel_to(lambda data, count: [ack(data, b"\0\0\0\x07")] if count == 3 else [])
    assert channel.read_register(0x938, soon()) == 7
    assert len(set(peer.seen)) == 1
    assert len(peer.seen) == 3


def test_answers_to_other_requests_and_garbage_are_ignored(channel_to):
    def answer(data, _):
        return [
            b"",
            b"\0",
            ack(data, bytes(4), shift=1),
            ack(data, bytes(4), command=0x83),
            ack(data, b"\0\0\0\x09"),
        ]

    _, channel = channel_to(answer)
    assert channel.read_register(0x938, soon()) == 9


def test_every_datagram_is_reported_in_both_directions_even_ignored_ones():
    peer, said = Answering(lambda data, _: [b"rubbish", ack(data, b"\0\0\0\x09")]), []
    channel = CameraControl("127.0.0.1", port=peer.port, on_bytes=lambda *on_bytes: said.append(on_bytes))
    channel.read_register(0x938, soon())
    channel.close()
    peer.close()
    (sent,) = peer.seen
    assert said == [
        (Direction.SENT, sent),
        (Direction.RECEIVED, b"rubbish"),
        (Direction.RECEIVED, ack(sent, b"\0\0\0\x09")),
    ]


def test_silence_ends_at_the_deadline(channel_to):
    peer, channel = channel_to(lambda data, _: [])
    start_s = time.monotonic()
    with pytest.raises(NoReply, match="GEV-007"):
        channel.write_register(0xA00, 2, soon(0.3))
    assert time.monotonic() - start_s > 0.25
    # asked at 0 and 0.2 s; without a deadline it would be asked twice more
    assert len(peer.seen) <= 2


def test_a_port_without_a_listener_ends_at_the_deadline_too():
    nobody = parse_endpoint(own_udp_endpoint())
    channel = CameraControl(nobody.host, port=nobody.port)
    with pytest.raises(NoReply, match="GEV-007"):
        channel.read_register(0, soon(0.3))
    channel.close()


def test_pending_extends_the_wait_without_a_resend(channel_to):
    now_s = 0.0

    def on_bytes(_direction, data):
        nonlocal now_s
        if data == b"rubbish":
            now_s = 1.9  # otherwise asked for again at 0.2 and 0.6 s, and given up at 1.5 s

    def answer(data, _):
        return [ack(data, struct.pack(">HH", 0, 2000), command=0x89), b"rubbish", ack(data, b"\0\0\0\x01")]

    peer, channel = channel_to(answer, monotonic=lambda: now_s, on_bytes=on_bytes)
    assert channel.read_register(0, 5.0) == 1
    assert len(peer.seen) <= 2  # the announcement itself may be late on a busy computer


def test_a_refusal_is_reported(channel_to):
    _, channel = channel_to(lambda data, _: [ack(data, status=0x8003)])
    with pytest.raises(CommandRefused, match=r"GEV-006.*invalid address"):
        channel.read_register(0x123, soon())


def test_memory_is_read_in_pieces(channel_to):
    store = bytes(range(256)) * 6

    def answer(data, _):
        address, _, count = struct.unpack_from(">IHH", data, 8)
        return [ack(data, data[8:12] + store[address : address + count])]

    peer, channel = channel_to(answer)
    assert channel.read_memory(0, 1301, soon()) == store[:1301]
    assert [struct.unpack_from(">IHH", data, 8)[2] for data in peer.seen] == [536, 536, 232]


def test_a_short_piece_of_memory_is_malformed(channel_to):
    _, channel = channel_to(lambda data, _: [ack(data, data[8:12] + b"\0\0")])
    with pytest.raises(MalformedReply, match="GEV-008"):
        channel.read_memory(0, 8, soon())


def test_a_camera_without_a_description_is_refused(channel_to):
    def answer(data, _):
        _, _, count = struct.unpack_from(">IHH", data, 8)
        return [ack(data, data[8:12] + b"http://somewhere/cam.xml".ljust(count, b"\0"))]

    _, channel = channel_to(answer)
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        fetch_description(channel, soon())


def test_commands_sent_together_leave_before_the_first_answer(channel_to):
    order = []

    def first(data, _):
        time.sleep(0.1)
        order.append("first answers")
        return [ack(data, bytes(4))]

    def second(data, _):
        order.append("second asked")
        return [ack(data, status=0x8006)]

    _, left = channel_to(first)
    _, right = channel_to(second)
    results = send_together(
        [(left, register_write(0x20, 1)), (right, register_write(0x20, 1))], soon(), "the trigger"
    )
    assert order == ["second asked", "first answers"]
    assert results[0] is None
    assert isinstance(results[1], CommandRefused)


def test_request_ids_are_never_zero_nor_the_last(channel_to):
    peer, channel = channel_to(lambda data, _: [ack(data, bytes(4))])
    channel._request_id = 0xFFFD
    for _ in range(3):
        channel.read_register(0, soon())
    assert [struct.unpack_from(">H", data, 6)[0] for data in peer.seen] == [
        0xFFFE,
        1,
        2,
    ]  # the last is kept free


def test_an_answer_that_arrived_while_the_host_stalled_counts(channel_to):
    _, channel = channel_to(lambda data, _: [ack(data, struct.pack(">I", 7))])
    past_s = time.monotonic() - 1.0
    assert channel.read_register(0, past_s) == 7


class HeldCamera:
    """Camera that refuses control a number of times; `heartbeat_ms` None: reading is refused too."""

    def __init__(
        self, refusals: int, heartbeat_ms: int | None, status: int = GevStatus.ACCESS_DENIED
    ) -> None:
        self.left, self.heartbeat_ms, self.status = refusals, heartbeat_ms, status
        self.peer_address = "127.99.9.9"
        self.asked = 0

    def write_register(self, address: int, value: int, deadline_s: float) -> None:
        assert (address, value) == (Bootstrap.CCP, gev.CCP_CONTROL)
        assert time.monotonic() < deadline_s
        self.asked += 1
        if self.asked <= self.left:
            raise self._refusal()

    def read_register(self, address: int, deadline_s: float) -> int:
        if address == Bootstrap.CCP:
            return gev.CCP_CONTROL
        assert address == Bootstrap.HEARTBEAT_TIMEOUT_MS
        if self.heartbeat_ms is None:
            raise self._refusal()
        return self.heartbeat_ms

    def _refusal(self) -> CommandRefused:
        error = CommandRefused("refused")
        error.status = self.status
        return error


def taken(camera: HeldCamera, limit_s: float) -> None:
    take_control(camera, "the left camera", time.monotonic() + limit_s)  # type: ignore[arg-type]


@pytest.mark.parametrize("heartbeat_ms", [3000, None])
def test_control_held_by_a_dead_client_is_awaited(heartbeat_ms: int | None) -> None:
    camera = HeldCamera(3, heartbeat_ms)
    taken(camera, 10.0)
    assert camera.asked == 4


def test_a_client_that_outlives_its_heartbeat_keeps_control() -> None:
    camera = HeldCamera(1000, 0)
    with pytest.raises(ControlTaken, match=r"GEV-005.*the left camera"):
        taken(camera, 60.0)  # the test's own time-out is the limit
    assert camera.asked > 1


def test_a_program_of_this_computer_that_keeps_control_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, holder = HeldCamera(1000, 0), os.getpid()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect((camera.peer_address, gev.GVCP_PORT))
        monkeypatch.setattr(os, "getpid", lambda: 1)
        with pytest.raises(ControlTaken, match=rf"pid {holder}.*leave it alone"):
            taken(camera, 60.0)


@pytest.mark.parametrize("heartbeat_ms", [60_000, None])
def test_control_is_awaited_no_longer_than_the_time_limit(heartbeat_ms: int | None) -> None:
    with pytest.raises(ControlTaken, match="GEV-005"):
        taken(HeldCamera(1000, heartbeat_ms), 0.5)


def test_another_refusal_is_not_taken_for_a_second_controller() -> None:
    camera = HeldCamera(1000, 3000, GevStatus.INVALID_ADDRESS)
    with pytest.raises(CommandRefused, match="GEV-006"):
        taken(camera, 10.0)
    assert camera.asked == 1


HANG_LIMIT_S = 30.0
SILENT = None


class ScriptedCamera:
    """Camera that gives the next of `answers` to each question for its privilege, after `takes_s`."""

    address = "192.168.3.11"

    def __init__(self, answers: list[int | None], takes_s: float) -> None:
        self.answers, self.takes_s = answers, takes_s
        self.now_s = 0.0
        self.asked = 0

    def monotonic(self) -> float:
        return self.now_s

    def read_register(self, _address: int, _deadline_s: float) -> int:
        self.now_s += self.takes_s
        answer = self.answers[min(self.asked, len(self.answers) - 1)]
        self.asked += 1
        if answer is SILENT:
            raise NoReply("no answer")
        return answer


def verdict(camera: ScriptedCamera, timeout_ms: int, monkeypatch: pytest.MonkeyPatch) -> RonnaError:
    said: list[RonnaError] = []
    heard = threading.Event()

    def lost(error: RonnaError) -> None:
        said.append(error)
        heard.set()

    monkeypatch.setattr(control_channel, "SLOWEST_BEAT_S", 0.0)
    beats = Heartbeat(camera, timeout_ms, lost, "test", monotonic=camera.monotonic)  # type: ignore[arg-type]
    assert heard.wait(HANG_LIMIT_S)
    beats.close()
    return said[0]


@pytest.mark.parametrize(("timeout_ms", "beats"), [(500, SILENT_BEATS), (3000, 3), (10_000, 10)])
def test_a_silent_camera_is_lost_once_its_time_out_has_passed(
    timeout_ms: int, beats: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = ScriptedCamera([CCP_CONTROL, SILENT], takes_s=1.0)
    error = verdict(camera, timeout_ms, monkeypatch)
    assert isinstance(error, CameraLost)
    assert camera.asked == 1 + beats
    assert f"silent for {beats}.0 s" in str(error)


def test_a_camera_that_answers_in_between_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = [SILENT, SILENT, CCP_CONTROL, SILENT, SILENT, CCP_CONTROL, CCP_OPEN]
    camera = ScriptedCamera(answers, takes_s=1.0)
    assert isinstance(verdict(camera, 3000, monkeypatch), ControlLost)
    assert camera.asked == len(answers)
