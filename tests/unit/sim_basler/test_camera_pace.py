"""How fast a camera sends: at the pace of its rows, never faster than its link, even after a stall."""

from __future__ import annotations

import itertools

import pytest

from sim.basler import stream_channel as stream
from sim.basler.camera.settings import Settings
from sim.basler.stream_channel import (
    BURST_BYTES,
    LONGEST_CREDIT_S,
    WIRE_BYTES_PER_S,
    Block,
    Frame,
    StreamChannel,
)

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
    monkeypatch.setattr(channel, "_send_packet", computer.put)
    frame = Settings().frame()
    channel.send(Block(1, Frame(frame, bytes(frame.payload_bytes), 1), PACKET_BYTES), duration_s)
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
