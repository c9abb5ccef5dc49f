"""Assembly of frames from GVSP packets, which may be lost, repeated or reordered. No I/O, no clock.

A frame is complete when leader, trailer and every payload packet have arrived. Missing packets are requested
again at growing intervals; after the last, the frame is delivered incomplete.
"""

from __future__ import annotations

import struct
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, NamedTuple

from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import GevStatus, GvspFormat

if TYPE_CHECKING:
    from ronna_hw.devices.readings import AreaOfInterest

RESEND_INTERVALS_S = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # after the last packet; then give up
AFTER_TRAILER_S = 0.002  # the first pause once a block has ended: packets may overtake each other
OPEN_BLOCKS = 15  # at full rate the next images begin before the last packets of this one are resent
PACKETS_PER_ROUND = 64  # requested at a time: a larger burst could overrun the socket again
Claim = Callable[[], tuple[int, bytearray | memoryview]]
"""Memory for the next frame, of the payload's size, and its number."""
_LEADER = struct.Struct(gev.GVSP_LEADER)
_UNPACK_HEADER = struct.Struct(gev.GVSP_HEADER).unpack_from
_UNAVAILABLE = frozenset(
    {GevStatus.PACKET_UNAVAILABLE, GevStatus.PACKET_REMOVED, GevStatus.PACKET_AND_PREVIOUS_REMOVED}
)


class PacketHeader(NamedTuple):
    """GVSP packet header of eight bytes."""

    status: int
    block_id: int
    kind: int  # a GvspFormat; arbitrary in the reply to a rejected resend request
    packet_id: int


class Leader(NamedTuple):
    """Fields of a GVSP image leader packet."""

    ticks: Annotated[int, "Q"]
    pixel_format: Annotated[int, "I"]
    offset_x: Annotated[int, "I"]
    offset_y: Annotated[int, "I"]
    width: Annotated[int, "I"]
    height: Annotated[int, "I"]
    padding_x: Annotated[int, "H"]

    @property
    def area(self) -> AreaOfInterest:
        """Sensor area; the late import keeps NumPy out of the receiver process."""
        from ronna_hw.devices.readings import AreaOfInterest

        return AreaOfInterest(self.offset_x, self.offset_y, self.width, self.height)


def decode_header(packet: memoryview) -> PacketHeader | None:
    """Decode a packet header, or return None unless it is a standard stream packet."""
    if len(packet) < gev.GVSP_HEADER_BYTES:
        return None
    status, block_id, word = _UNPACK_HEADER(packet)
    kind = word >> gev.GVSP_FORMAT_SHIFT & gev.GVSP_FORMAT_MASK
    if word & gev.GVSP_EXTENDED_ID_BIT or block_id == 0:
        return None
    return PacketHeader(status, block_id, kind, word & gev.GVSP_PACKET_ID_MASK)


def decode_leader(content: memoryview) -> Leader | None:
    """Decode a leader, or return None unless it announces an image."""
    if len(content) < gev.GVSP_LEADER_BYTES:
        return None
    _, payload_type, ticks, pixel_format, width, height, x, y, padding_x, _ = _LEADER.unpack_from(content)
    if payload_type != gev.PayloadType.IMAGE:
        return None
    return Leader(ticks, pixel_format, x, y, width, height, padding_x)


def next_block_id(block_id: int) -> int:
    """Return the next block id; ids wrap around and skip 0."""
    return block_id % gev.BLOCK_ID_LAST + gev.BLOCK_ID_FIRST


@dataclass(frozen=True)
class ReceivedImage:
    """Received image: raw bytes and leader (None if it was lost)."""

    block_id: int
    leader: Leader | None
    data: bytearray | memoryview
    missing_packets: int
    slot: int = 0  # position of `data` in the memory given to the assembler


@dataclass
class StreamCounters:
    """Stream statistics since opening."""

    packets: int = 0
    ignored: int = 0  # not in standard form, not of an open block, or of the wrong length
    duplicates: int = 0
    resend_requests: int = 0
    frames: int = 0
    incomplete_frames: int = 0
    refusals: int = 0  # resend requests for packets that the camera no longer has
    foreign: int = 0  # datagrams from other addresses than the camera's, which were dropped


@dataclass
class _Block:
    block_id: int
    slot: int
    data: bytearray | memoryview
    received: bytearray  # one flag per packet id, including leader and trailer
    leader: Leader | None = None
    remaining: int = 0
    rounds: int = 0  # of resend requests since one was completely fulfilled
    requested: list[int] = field(default_factory=list)  # packets of the last resend request
    last_packet_s: float = 0.0
    unavailable: set[int] = field(default_factory=set)


class FrameAssembler:
    """Frame assembler for one stream with known payload and packet size.

    Frames are stored in the memory from `claim`, by default newly allocated.
    """

    def __init__(self, payload_bytes: int, packet_bytes: int, claim: Claim | None = None) -> None:
        self._payload_bytes = payload_bytes
        self._claim = claim or (lambda: (0, bytearray(payload_bytes)))
        self._data_bytes = packet_bytes - gev.GVSP_OVERHEAD_BYTES
        self._full_bytes = gev.GVSP_HEADER_BYTES + self._data_bytes
        self._payload_packets = -(-payload_bytes // self._data_bytes)
        self._trailer_id = self._payload_packets + 1
        self._open: OrderedDict[int, _Block] = OrderedDict()
        self._newest = 0  # block id; 0 before the first
        # the last block ids: their repeated packets are not a new block
        self._finished: deque[int] = deque(maxlen=2 * OPEN_BLOCKS)
        self.counters = StreamCounters()

    @property
    def is_waiting(self) -> bool:
        """Whether any frame is still incomplete."""
        return bool(self._open)

    def expect(self, block_id: int, from_s: float) -> None:
        """Expect a triggered block, so that it is requested even if all of its packets are lost."""
        if block_id in self._finished or block_id in self._open or len(self._open) >= OPEN_BLOCKS:
            return
        self._open_block(block_id).last_packet_s = from_s

    def accept(self, packet: memoryview, now_s: float) -> ReceivedImage | None:
        """Process one packet; returns a frame that it completes or that a newer block displaces."""
        self.counters.packets += 1
        if self._store_fast(packet, now_s):
            return None
        header = decode_header(packet)
        if header is None or header.packet_id > self._trailer_id or header.block_id in self._finished:
            self.counters.ignored += 1
            return None
        if header.block_id not in self._open:
            self._expect_skipped(header.block_id, now_s)
        displaced = self._displace_oldest(header.block_id)
        block = self._open_block(header.block_id)
        block.last_packet_s = now_s
        self._accept_content(block, header, packet[gev.GVSP_HEADER_BYTES :])
        # a single packet never completes a block, so no frame is lost here
        return self._finish_block(block) if block.remaining == 0 else displaced

    def find_overdue(self, now_s: float) -> tuple[list[tuple[int, int, int]], ReceivedImage | None]:
        """Return overdue packets as (block id, first, last packet id), or a frame given up as incomplete."""
        for block in list(self._open.values()):
            if now_s - block.last_packet_s < self._resend_pause_s(block):
                continue
            missing = [
                i for i in range(self._trailer_id + 1) if not block.received[i] and i not in block.unavailable
            ]
            if self._is_fulfilled(block):
                block.rounds = 0
            is_exhausted = block.rounds >= len(RESEND_INTERVALS_S)
            # an expected block that has not begun may be late: it is requested until displaced
            if not missing or (is_exhausted and block.remaining <= self._trailer_id):
                return [], self._finish_block(block)
            block.rounds += not is_exhausted
            block.last_packet_s = now_s
            block.requested = missing[:PACKETS_PER_ROUND] if block.remaining <= self._trailer_id else missing
            ranges = _group_ranges(block.requested)
            self.counters.resend_requests += len(ranges)
            return [(block.block_id, first, last) for first, last in ranges], None
        return [], None

    def _resend_pause_s(self, block: _Block) -> float:
        """Return how long to wait after a block's last packet before requesting a resend."""
        if self._is_fulfilled(block):
            return AFTER_TRAILER_S
        if block.rounds == 0 and block.remaining <= self._trailer_id:
            has_newer_begun = next(reversed(self._open.values())) is not block
            if has_newer_begun or block.received[self._trailer_id]:
                return AFTER_TRAILER_S
        return RESEND_INTERVALS_S[min(block.rounds, len(RESEND_INTERVALS_S) - 1)]

    def _expect_skipped(self, block_id: int, now_s: float) -> None:
        """Expect all blocks skipped since the newest one."""
        newest, self._newest = self._newest, block_id
        skipped = (block_id - newest - 1) % gev.BLOCK_ID_LAST if newest else 0
        if skipped >= OPEN_BLOCKS:
            self._newest = max(newest, block_id)  # a straggler or a wrap-around: no conclusion
            return
        for _ in range(skipped):
            newest = next_block_id(newest)
            self.expect(newest, now_s)

    @staticmethod
    def _is_fulfilled(block: _Block) -> bool:
        return bool(block.requested) and all(block.received[packet_id] for packet_id in block.requested)

    def _open_block(self, block_id: int) -> _Block:
        if (block := self._open.get(block_id)) is None:
            block = _Block(
                block_id, *self._claim(), bytearray(self._trailer_id + 1), remaining=self._trailer_id + 1
            )
            self._open[block_id] = block
        return block

    def _displace_oldest(self, block_id: int) -> ReceivedImage | None:
        if block_id in self._open or len(self._open) < OPEN_BLOCKS:
            return None
        return self._finish_block(next(iter(self._open.values())))

    def _store_fast(self, packet: memoryview, now_s: float) -> bool:
        """Store a full-size new packet of an open block, unless it completes the block."""
        if len(packet) != self._full_bytes:
            return False
        status, block_id, word = _UNPACK_HEADER(packet)
        block = self._open.get(block_id)
        if (
            block is None
            or status
            or word >> gev.GVSP_FORMAT_SHIFT != GvspFormat.PAYLOAD
            or block.remaining == 1
        ):
            return False
        packet_id = word & gev.GVSP_PACKET_ID_MASK
        if not 0 < packet_id < self._payload_packets or block.received[packet_id]:
            return False
        begin = (packet_id - 1) * self._data_bytes
        block.data[begin : begin + self._data_bytes] = packet[gev.GVSP_HEADER_BYTES :]
        block.received[packet_id] = 1
        block.remaining -= 1
        block.last_packet_s = now_s
        return True

    def _accept_content(self, block: _Block, header: PacketHeader, content: memoryview) -> None:
        packet_id = header.packet_id
        if header.status in _UNAVAILABLE:
            self.counters.refusals += 1
            # until the trailer arrives, "unavailable" may mean "not yet"
            if block.received[self._trailer_id]:
                block.unavailable.add(packet_id)
        elif block.received[packet_id]:
            self.counters.duplicates += 1
        elif self._store(block, header, content):
            block.received[packet_id] = 1
            block.remaining -= 1
        else:
            self.counters.ignored += 1

    def _store(self, block: _Block, header: PacketHeader, content: memoryview) -> bool:
        """Store a packet's content; returns False if its kind or length does not match its id."""
        if (packet_id := header.packet_id) == gev.LEADER_PACKET_ID:
            block.leader = decode_leader(content) if header.kind == GvspFormat.LEADER else None
            return block.leader is not None
        if packet_id == self._trailer_id:
            return header.kind == GvspFormat.TRAILER
        begin, end = self._payload_range(packet_id)
        if header.kind != GvspFormat.PAYLOAD or len(content) != end - begin:
            return False
        block.data[begin:end] = content
        return True

    def _finish_block(self, block: _Block) -> ReceivedImage | None:
        del self._open[block.block_id]
        if block.remaining > self._trailer_id:
            return None  # expected, never seen
        self._finished.append(block.block_id)
        missing = [i for i in range(1, self._trailer_id) if not block.received[i]] if block.remaining else []
        for packet_id in missing:
            begin, end = self._payload_range(packet_id)
            block.data[begin:end] = bytes(end - begin)  # not the pixels of an earlier frame
        self.counters.frames += 1
        self.counters.incomplete_frames += bool(missing) or block.leader is None
        return ReceivedImage(block.block_id, block.leader, block.data, len(missing), block.slot)

    def _payload_range(self, packet_id: int) -> tuple[int, int]:
        """Return the byte range of a payload packet."""
        begin = (packet_id - 1) * self._data_bytes
        return begin, min(begin + self._data_bytes, self._payload_bytes)


def _group_ranges(numbers: list[int]) -> list[tuple[int, int]]:
    """Group ascending numbers into consecutive runs, as (first, last)."""
    runs: list[tuple[int, int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1] = (runs[-1][0], number)
        else:
            runs.append((number, number))
    return runs
