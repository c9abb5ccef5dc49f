"""The traffic on one camera's links, for recording.

Every datagram of the control channel; of the stream what each image says about itself, and the counters. The
receiver process sends its resend requests and keep-alives by itself: they are not among the datagrams.
"""

from __future__ import annotations

from dataclasses import asdict

from drivers.basler_stereo.stream.frame_assembler import Frame, StreamCounters
from ronna_hw.devices.byte_sink import ByteSink, Direction


class LinkBytes:
    """Of the camera `name`, such as `stereo.left`; `sink` is None without a recorder."""

    def __init__(self, name: str, sink: ByteSink | None) -> None:
        self._name = name
        self._sink = sink

    def passed(self, direction: Direction, data: bytes) -> None:
        """A datagram of the control channel."""
        if self._sink is not None:
            self._sink.passed(f"{self._name}.control", direction, data)

    def note_frame(self, frame: Frame, counters: StreamCounters) -> None:
        """An image came, whole or not."""
        if self._sink is None:
            return
        leader = {} if frame.leader is None else frame.leader._asdict()
        self._sink.note(
            f"{self._name}.stream",
            block_id=frame.block_id,
            missing_packets=frame.missing_packets,
            **leader,
            **asdict(counters),
        )
