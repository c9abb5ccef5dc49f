"""Acquisition, triggers and stream packets of one camera, and of a pair in lock-step."""

from __future__ import annotations

import itertools
import struct
from typing import Any

import numpy as np
import pytest

from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler import stream_channel as stream
from sim.basler.settings import SOFTWARE_TRIGGER_SKEW_NS, CameraSettings, readout_us
from sim.basler.stream_channel import (
    BURST_BYTES,
    LONGEST_CREDIT_S,
    WIRE_BYTES_PER_S,
    Block,
    SentImage,
    StreamChannel,
)

OK = 0
RESEND, ACTION = 0x40, 0x100
LEADER_LAYOUT = ">HHQIIIIIHH"


def triggered(bench: Any) -> None:
    """A camera that waits for software triggers, small frames."""
    bench.stream(TriggerMode=1, AcquisitionStart=1)


def header(packet: bytes) -> tuple[int, int, int, int]:
    """Status, block id, format and packet id."""
    status, block, word = struct.unpack_from(">HHI", packet)
    return status, block, word >> 24 & 0x7F, word & 0xFFFFFF


def stamp(frame: list[bytes]) -> int:
    return int(struct.unpack_from(LEADER_LAYOUT, frame[0], 8)[2])


def test_a_frame_carries_the_picture_and_its_trailer_the_number_of_rows(bench: Any) -> None:
    triggered(bench)
    frame = bench.shoot()
    assert b"".join(packet[8:] for packet in frame[1:-1]) == b"\1" * (64 * 48)
    assert struct.unpack_from(">HHI", frame[-1], 8) == (0, 1, 48)


def test_the_leader_carries_geometry_format_and_time(bench: Any) -> None:
    bench.stream()
    for name, value in (("OffsetX", 160), ("OffsetY", 33), ("PixelFormat", PixelFormat.MONO12)):
        assert bench.set(name, value) == OK
    bench.put(TriggerMode=1, AcquisitionStart=1)
    moment_ns = bench.clock.time_ns
    leader = struct.unpack_from(LEADER_LAYOUT, bench.shoot()[0], 8)
    assert leader == (0, 1, moment_ns // 8, PixelFormat.MONO12, 64, 48, 160, 33, 0, 0)


def pictures(bench: Any, count: int) -> list[int]:
    """Numbers of the pictures that so many triggers give."""
    found = []
    for _ in range(count):
        found.append(bench.shoot()[1][8])
    return found


def restart(bench: Any) -> None:
    bench.put(AcquisitionStop=1, AcquisitionStart=1)


def test_restarting_an_acquisition_at_the_same_position_repeats_its_last_picture(bench: Any) -> None:
    bench.images.where = b"here"
    triggered(bench)
    assert pictures(bench, 3) == [1, 2, 3]
    restart(bench)
    restart(bench)
    assert pictures(bench, 2) == [3, 4]


@pytest.mark.parametrize("change", [("place", b"there"), ("Width", 96), ("ExposureTimeRaw", 5000)])
def test_an_acquisition_at_another_position_or_setting_counts_from_one(
    bench: Any, change: tuple[str, Any]
) -> None:
    bench.images.where = b"here"
    triggered(bench)
    assert pictures(bench, 2) == [1, 2]
    bench.put(AcquisitionStop=1)
    name, value = change
    if name == "place":
        bench.images.where = value
    else:
        assert bench.set(name, value) == OK
    bench.put(AcquisitionStart=1)
    assert pictures(bench, 2) == [1, 2]


def test_block_ids_wrap_to_one(bench: Any) -> None:
    triggered(bench)
    bench.camera.channel._next_block_id = 65535
    found = []
    for _ in range(2):
        found.append(header(bench.shoot()[0])[1])
    assert found == [65535, 1]


def test_triggers_while_busy_are_dropped_and_counted(bench: Any) -> None:
    triggered(bench)
    bench.images.gate.clear()
    for _ in range(4):
        bench.put(TriggerSoftware=1)
    assert bench.get("AcquisitionStatus") == 0
    bench.images.gate.set()
    bench.frame()
    assert bench.nothing_comes()
    assert bench.get("OvertriggerCount") == 3
    assert bench.get("AcquisitionStatus") == 1


@pytest.mark.parametrize("spoil", [("TriggerMode", 0), ("TriggerSource", 1), ("TriggerSelector", 0)])
def test_a_trigger_that_is_not_enabled_does_nothing(bench: Any, spoil: tuple[str, int]) -> None:
    bench.stream(TriggerMode=1)
    assert bench.set("TriggerSoftware", 1) == OK  # before the start
    bench.put(AcquisitionStart=1)
    if spoil == ("TriggerMode", 0):
        bench.put(AcquisitionStop=1)
        assert bench.set(*spoil) == OK
    else:
        assert bench.set(*spoil) == OK
        bench.put(TriggerSoftware=1)
    assert bench.nothing_comes()


def test_timestamps_grow_even_when_theatre_time_stops(bench: Any) -> None:
    bench.stream(AcquisitionStart=1)
    stamps = [stamp(bench.frame()) for _ in range(5)]
    assert np.all(np.diff(stamps) > 0)


def test_free_running_frames_are_one_period_apart(bench: Any) -> None:
    bench.stream(AcquisitionFrameRateEnable=1, AcquisitionFrameRateAbs=40.0, AcquisitionStart=1)
    stamps = [stamp(bench.frame()) for _ in range(5)]
    assert np.diff(stamps).tolist() == [125_000_000 // 40] * 4


def test_single_frame_mode_takes_one_frame(bench: Any) -> None:
    bench.stream(AcquisitionMode=0)
    for _ in range(2):
        bench.put(AcquisitionStart=1)
        assert header(bench.frame()[0])[1] == 1
        assert bench.nothing_comes()


def test_an_acquisition_start_trigger_permits_a_number_of_frames(bench: Any) -> None:
    bench.stream(TriggerSelector=0, TriggerMode=1, AcquisitionFrameCount=3, AcquisitionStart=1)
    assert bench.nothing_comes()
    assert [header(bench.shoot()[0])[1] for _ in range(3)] == [1, 2, 3]
    assert bench.nothing_comes()


def test_a_trigger_delay_postpones_the_exposure(bench: Any) -> None:
    bench.stream(TriggerMode=1, TriggerDelayAbs=800.0, AcquisitionStart=1)
    moment_ns = bench.clock.time_ns
    assert stamp(bench.shoot()) == (moment_ns + 800_000) // 8


def test_a_trigger_in_lock_step_advances_the_theatre_by_exposure_and_readout(bench: Any) -> None:
    triggered(bench)
    begun_ns = bench.clock.time_ns
    bench.shoot()
    frame = CameraSettings(width=64, height=48).frame()
    assert bench.clock.time_ns - begun_ns == frame.exposure_us * 1000 + round(readout_us(frame) * 1e3)


def test_a_pair_in_lock_step_takes_the_time_of_one_frame(make_bench: Any) -> None:
    left = make_bench()
    right = make_bench("right", "21904412", beside=left)
    for camera in (left, right):
        triggered(camera)
    begun_ns = left.clock.time_ns
    for number in range(3):
        first = stamp(left.shoot())  # the theatre has advanced before the second trigger comes
        second = stamp(right.shoot())
        assert 0 <= second - first <= SOFTWARE_TRIGGER_SKEW_NS // 8
        frame = CameraSettings(width=64, height=48).frame()
        one_ns = frame.exposure_us * 1000 + round(readout_us(frame) * 1e3)
        assert left.clock.time_ns - begun_ns <= (number + 1) * (one_ns + SOFTWARE_TRIGGER_SKEW_NS)


def test_an_action_is_acknowledged_only_by_the_addressed_cameras(bench: Any) -> None:
    bench.take_control(stream=True)
    for name, value in (("ActionDeviceKey", 0xABCD), ("ActionGroupKey", 7), ("ActionGroupMask", 1)):
        assert bench.set(name, value) == OK

    def act(mask: int) -> bytes | None:
        datagram = bench.datagram(ACTION, struct.pack(">III", 0xABCD, 7, mask))
        answer: bytes | None = bench.camera.port.answer(datagram, ("127.0.0.1", 50000))
        return answer

    assert act(2) is None
    answer = act(3)
    assert answer is not None
    assert answer[:4] == bytes((0, 0, 1, 1))


def test_a_scheduled_action_is_refused_without_a_common_clock(bench: Any) -> None:
    bench.take_control()
    status, _, _ = bench.ask(ACTION, struct.pack(">IIIQ", 0, 0, 0, 5), flags=0x81)
    assert status == 0x8013


def test_only_the_requested_range_of_packets_is_resent(bench: Any) -> None:
    triggered(bench)
    frame = bench.shoot()
    for flags, payload in (
        (0, struct.pack(">HHII", 0, 1, 1, 2)),
        (0x10, struct.pack(">HHIIQ", 0, 0, 1, 2, 1)),
    ):
        bench.camera.port.answer(bench.datagram(RESEND, payload, flags=flags), ("127.0.0.1", 1))
        assert [packet[2:] for packet in bench.packets(2)] == [packet[2:] for packet in frame[1:3]]
        assert bench.nothing_comes()


def test_another_host_cannot_request_packets(bench: Any) -> None:
    triggered(bench)
    bench.shoot()
    request = bench.datagram(RESEND, struct.pack(">HHII", 0, 1, 1, 1), flags=0)
    bench.camera.port.answer(request, ("127.0.0.9", 1))
    assert bench.nothing_comes()


PACKET_BYTES = 8000
READOUT_S = 0.02


class StallingComputer:
    """The host's clock, which only sleeping advances, and once a stall."""

    def __init__(self, stall_before: int, stall_s: float) -> None:
        self.now_s = 100.0
        self.sent: list[float] = []
        self._stall_before, self._stall_s = stall_before, stall_s

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def put(self, *_: object) -> None:
        if len(self.sent) == self._stall_before:
            self.now_s += self._stall_s
        self.sent.append(self.now_s)


def sent_by(monkeypatch: pytest.MonkeyPatch, computer: StallingComputer, duration_s: float) -> list[float]:
    """When each packet of a full frame leaves."""
    channel = StreamChannel("127.0.0.1", lambda: "127.0.0.1")
    channel.port, channel.packet_size = 9, PACKET_BYTES
    monkeypatch.setattr(stream, "time", computer)
    monkeypatch.setattr(channel, "_transmit", computer.put)
    frame = CameraSettings().frame()
    channel.send(Block(1, SentImage(frame, bytes(frame.payload_bytes), 1), PACKET_BYTES), duration_s)
    channel.close()
    return computer.sent


def busiest_bytes(times: list[float], window_s: float) -> int:
    """Most bytes that leave within a window."""
    first, most = 0, 0
    for last, moment in enumerate(times):
        while moment - times[first] > window_s:
            first += 1
        most = max(most, last - first + 1)
    return most * PACKET_BYTES


def test_a_frame_takes_the_time_its_rows_need(monkeypatch: pytest.MonkeyPatch) -> None:
    times = sent_by(monkeypatch, StallingComputer(-1, 0.0), READOUT_S)
    assert times[-1] - times[0] == pytest.approx(READOUT_S, rel=0.05)
    assert all(later >= earlier for earlier, later in itertools.pairwise(times))


@pytest.mark.parametrize("stall_s", [0.001, 0.01, 0.1])
def test_packets_held_back_by_a_stall_are_sent_no_faster_than_the_link(
    monkeypatch: pytest.MonkeyPatch, stall_s: float
) -> None:
    times = sent_by(monkeypatch, StallingComputer(100, stall_s), 0.0)
    window_s = 0.005
    link = WIRE_BYTES_PER_S * (window_s + LONGEST_CREDIT_S) + 2 * BURST_BYTES
    assert busiest_bytes(times, window_s) <= link
    free = len(times) * PACKET_BYTES / WIRE_BYTES_PER_S
    assert times[-1] - times[0] >= free + stall_s - LONGEST_CREDIT_S - 0.001


def test_a_short_delay_is_caught_up(monkeypatch: pytest.MonkeyPatch) -> None:
    times = sent_by(monkeypatch, StallingComputer(100, LONGEST_CREDIT_S / 2), READOUT_S)
    assert times[-1] - times[0] == pytest.approx(READOUT_S, rel=0.05)
