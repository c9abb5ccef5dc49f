"""Interface between driver and receiver process: orders, and frames in shared memory.

An order is one datagram with the file descriptors it needs. The memory is anonymous and passed by file
descriptor, so nothing is left behind whichever process dies. Frames rotate through a few slots. Each slot has
a use count, which a reader compares before and after copying to detect a frame overwritten in between.
Neither side ever waits for the other.
"""

from __future__ import annotations

import json
import mmap
import os
import socket
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Annotated, NamedTuple, get_args

from drivers.basler_stereo.stream.frame_assembler import Leader, ReceivedImage, StreamCounters
from ronna_hw.host.row_codec import RowCodec
from ronna_hw.host.shared_memory import MemoryMap

LONGEST_ORDER_BYTES = 4096
MOST_DESCRIPTORS = 4
SLOTS = 32  # more than can be in reception at a time; the others stay complete for a third of a second
_MAP = MemoryMap(b"frames")
_COUNTERS = _MAP.counters(len(fields(StreamCounters)))
_USE_COUNTS = _MAP.counters(SLOTS)
_DATA_AT = -(-_MAP.size_bytes // mmap.PAGESIZE) * mmap.PAGESIZE


@dataclass(frozen=True)
class OpenImageStream:
    """Order to receive a stream; passes descriptors of stream, control, memory and note channel."""

    stream: int
    payload_bytes: int
    packet_bytes: int
    resend: bool


@dataclass(frozen=True)
class CloseImageStream:
    """Order to stop receiving a stream."""

    stream: int


@dataclass(frozen=True)
class ExpectBlock:
    """Order to request a triggered block if none of it arrives within `patience_s`."""

    stream: int
    block_id: int
    patience_s: float


@dataclass(frozen=True)
class KeepAlive:
    """Order to send keep-alives to a camera; passes the control socket's descriptor."""

    camera: int
    period_s: float


@dataclass(frozen=True)
class EndKeepAlive:
    """Order to stop sending keep-alives."""

    camera: int


Order = OpenImageStream | CloseImageStream | ExpectBlock | KeepAlive | EndKeepAlive


_KINDS: dict[str, type[Order]] = {kind.__name__: kind for kind in get_args(Order)}


def send_order(channel: socket.socket, order: Order, descriptors: Sequence[int] = ()) -> None:
    """Send an order; raises OSError if the receiver process has ended."""
    text = json.dumps({"order": type(order).__name__, **asdict(order)}).encode()
    socket.send_fds(channel, [text], list(descriptors))


def receive_order(channel: socket.socket) -> tuple[Order, list[int]] | None:
    """Receive the next order with its descriptors, or None if the driver has ended."""
    text, descriptors, _, _ = socket.recv_fds(channel, LONGEST_ORDER_BYTES, MOST_DESCRIPTORS)
    if not text:
        return None
    fields = json.loads(text)
    return _KINDS[fields.pop("order")](**fields), descriptors


class _FrameNote(NamedTuple):
    """Message that announces a finished frame and its slot in shared memory."""

    slot: Annotated[int, "I"]
    use_count: Annotated[int, "Q"]
    block_id: Annotated[int, "I"]
    missing_packets: Annotated[int, "I"]
    leader: Leader | None


_NOTE = RowCodec(_FrameNote)


NOTE_BYTES = _NOTE.size_bytes


class FrameSlots:
    """Shared memory of one stream, as used by driver and receiver process."""

    def __init__(self, fd: int, payload_bytes: int) -> None:
        self._payload_bytes = payload_bytes
        self._memory = mmap.mmap(fd, _memory_size(payload_bytes))
        self._view = memoryview(self._memory)
        self._use_counts = _USE_COUNTS.view(self._memory)
        self._counters = _COUNTERS.view(self._memory)
        self._claimed = 0

    @staticmethod
    def allocate(payload_bytes: int) -> int:
        """Allocate shared memory for frames of this size and return its descriptor."""
        fd = os.memfd_create("basler_stereo")
        os.ftruncate(fd, _memory_size(payload_bytes))
        return fd

    def claim(self) -> tuple[int, memoryview]:
        """Claim the least recently written slot for overwriting; return its number and memory."""
        self._claimed += 1
        slot = self._claimed % SLOTS
        self._use_counts[slot] = self._claimed
        begin = _DATA_AT + slot * self._payload_bytes
        return slot, self._view[begin : begin + self._payload_bytes]

    def note(self, frame: ReceivedImage) -> bytes:
        """Encode the note that announces a finished frame."""
        use_count = self._use_counts[frame.slot]
        note = _FrameNote(frame.slot, use_count, frame.block_id, frame.missing_packets, frame.leader)
        return _NOTE.pack(note)

    def fetch(self, note: bytes) -> ReceivedImage | None:
        """Copy a frame from its slot, or return None if a newer frame has overwritten it."""
        slot, use_count, block_id, missing, leader = _NOTE.unpack(note)
        if self._use_counts[slot] != use_count:
            return None
        begin = _DATA_AT + slot * self._payload_bytes
        data = bytearray(self._view[begin : begin + self._payload_bytes])
        if self._use_counts[slot] != use_count:
            return None
        return ReceivedImage(block_id, leader, data, missing)

    def write_counters(self, counters: StreamCounters) -> None:
        """Publish the counters to the driver."""
        for index, count in enumerate(vars(counters).values()):
            self._counters[index] = count

    def counters(self) -> StreamCounters:
        """Read the counters published by the receiver process."""
        return StreamCounters(*self._counters)


def _memory_size(payload_bytes: int) -> int:
    return _DATA_AT + SLOTS * payload_bytes
