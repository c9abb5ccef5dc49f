"""One frame as a block of packets: leader, payload, trailer."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ronna_hw.wire.gige_vision import (
    GVSP_FORMAT_SHIFT,
    GVSP_HEADER,
    GVSP_LEADER,
    GVSP_OVERHEAD_BYTES,
    GVSP_TRAILER,
    LEADER_PACKET_ID,
    GevStatus,
    GvspFormat,
    PayloadType,
)
from sim.basler.camera.settings import FrameSettings


@dataclass(frozen=True)
class Frame:
    """An image ready for the wire, with the settings it was taken with and its time stamp in ticks."""

    settings: FrameSettings
    image: bytes
    stamp_ticks: int


class Block:
    """The packets of one frame for one packet size, created on demand."""

    def __init__(self, block_id: int, frame: Frame, packet_size: int) -> None:
        self.block_id = block_id
        self._frame = frame
        self._image = memoryview(frame.image)
        self._share = packet_size - GVSP_OVERHEAD_BYTES
        self._payloads = -(-len(frame.image) // self._share)

    @property
    def trailer_id(self) -> int:
        """Packet id of the last packet."""
        return self._payloads + 1

    def packet(
        self, packet_id: int, status: GevStatus = GevStatus.SUCCESS
    ) -> tuple[bytes, bytes | memoryview]:
        """Header and content of a packet, 0 to `trailer_id`."""
        if packet_id == LEADER_PACKET_ID:
            return self._header(status, GvspFormat.LEADER, packet_id), self._leader()
        if packet_id == self.trailer_id:
            return self._header(status, GvspFormat.TRAILER, packet_id), self._trailer()
        start = (packet_id - 1) * self._share
        content = self._image[start : start + self._share]
        return self._header(status, GvspFormat.PAYLOAD, packet_id), content

    def _header(self, status: GevStatus, kind: GvspFormat, packet_id: int) -> bytes:
        return header(status, self.block_id, kind, packet_id)

    def _leader(self) -> bytes:
        settings = self._frame.settings
        area = settings.area
        geometry = (area.width, area.height, area.x, area.y)
        return struct.pack(
            GVSP_LEADER, 0, PayloadType.IMAGE, self._frame.stamp_ticks, settings.pixel_format, *geometry, 0, 0
        )

    def _trailer(self) -> bytes:
        return struct.pack(GVSP_TRAILER, 0, PayloadType.IMAGE, self._frame.settings.area.height)


def header(status: GevStatus, block_id: int, kind: GvspFormat, packet_id: int) -> bytes:
    """Header of a stream packet."""
    return struct.pack(GVSP_HEADER, status, block_id, kind << GVSP_FORMAT_SHIFT | packet_id)
