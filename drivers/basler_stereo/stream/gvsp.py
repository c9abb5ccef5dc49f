"""GVSP packets from bytes: header and leader. No I/O."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

from ronna_hw.wire import gige_vision as gev

if TYPE_CHECKING:
    from ronna_hw.devices.readings import AreaOfInterest

_HEADER = struct.Struct(gev.GVSP_HEADER)
_LEADER = struct.Struct(gev.GVSP_LEADER)


class PacketHeader(NamedTuple):
    """The eight bytes before every packet's content."""

    status: int
    block_id: int
    kind: int  # a GvspFormat; arbitrary in the reply to a rejected resend request
    packet_id: int


class Leader(NamedTuple):
    """What a camera announces about an image before sending it."""

    ticks: int
    pixel_format: int
    offset_x: int
    offset_y: int
    width: int
    height: int
    padding_x: int

    @property
    def area(self) -> AreaOfInterest:
        """The part of the sensor. Imported here: the receiver process needs neither readings nor numpy."""
        from ronna_hw.devices.readings import AreaOfInterest

        return AreaOfInterest(self.offset_x, self.offset_y, self.width, self.height)


def decode_header(packet: memoryview) -> PacketHeader | None:
    """The header, or None for bytes that are not a standard stream packet."""
    if len(packet) < gev.GVSP_HEADER_BYTES:
        return None
    status, block_id, word = _HEADER.unpack_from(packet)
    kind = word >> gev.GVSP_FORMAT_SHIFT & gev.GVSP_FORMAT_MASK
    if word & gev.GVSP_EXTENDED_ID_BIT or block_id == 0:
        return None
    return PacketHeader(status, block_id, kind, word & gev.GVSP_PACKET_ID_MASK)


def decode_leader(content: memoryview) -> Leader | None:
    """The leader of an image, or None for the leader of anything else."""
    if len(content) < gev.GVSP_LEADER_BYTES:
        return None
    _, payload_type, ticks, pixel_format, width, height, x, y, padding_x, _ = _LEADER.unpack_from(content)
    if payload_type != gev.PayloadType.IMAGE:
        return None
    return Leader(ticks, pixel_format, x, y, width, height, padding_x)


def following(block_id: int) -> int:
    """The next block id; it wraps around and is never 0."""
    return block_id % gev.BLOCK_ID_LAST + gev.BLOCK_ID_FIRST
