"""The traffic on one camera's links, for recording.

Every datagram of the control channel; for the stream, a note per image, and the counters. Resend requests and
keep-alives are sent by the receiver process and are not included.
"""

from __future__ import annotations

from dataclasses import asdict

from drivers.basler_stereo.stream.frame_assembler import Frame, StreamCounters
from ronna_hw.devices.capabilities import ByteSink, Direction


class LinkBytes:
    """For the camera `name`, such as `stereo.left`; `sink` is None without a recorder."""

    def __init__(self, name: str, sink: ByteSink | None) -> None:
        self._name = name
        self._sink = sink

    def passed(self, direction: Direction, data: bytes) -> None:
        """A datagram of the control channel."""
        if self._sink is not None:
            self._sink.passed(f"{self._name}.control", direction, data)

    def note_frame(self, frame: Frame, counters: StreamCounters) -> None:
        """Record the arrival of an image, complete or not."""
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
