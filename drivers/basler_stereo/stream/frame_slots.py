"""Frames in shared memory: written by the receiver process, copied out by the driver.

The memory is anonymous and passed by file descriptor, so nothing is left behind whichever process dies.
Frames rotate through a few slots. Each slot has a use count, which a reader compares before and after copying
to detect a frame overwritten in between. Neither side ever waits for the other.
"""

from __future__ import annotations

import mmap
import os
from dataclasses import fields
from typing import Annotated, NamedTuple

from drivers.basler_stereo.stream.frame_assembler import Frame, StreamCounters
from drivers.basler_stereo.stream.gvsp import Leader
from ronna_hw.host.shared_memory import FieldCode, MemoryMap, RowCodec

SLOTS = 32  # more than can be in reception at a time; the others stay complete for a third of a second
_MAP = MemoryMap(b"frames")
_COUNTERS = _MAP.counters(len(fields(StreamCounters)))
_USE_COUNTS = _MAP.counters(SLOTS)
_DATA_AT = -(-_MAP.size_bytes // mmap.PAGESIZE) * mmap.PAGESIZE


def _packed_leader(leader: Leader | None) -> tuple[int, ...]:
    return (leader is not None, *(leader or (0,) * len(Leader._fields)))


def _unpacked_leader(values: tuple[int, ...]) -> Leader | None:
    came, *leader = values
    return Leader(*leader) if came else None


class _FrameNote(NamedTuple):
    """What a reader needs to fetch a finished frame."""

    slot: Annotated[int, "I"]
    use_count: Annotated[int, "Q"]
    block_id: Annotated[int, "I"]
    missing_packets: Annotated[int, "I"]
    leader: Annotated[Leader | None, FieldCode("?QIIIIIH", _packed_leader, _unpacked_leader)]


_NOTE = RowCodec(_FrameNote)
NOTE_BYTES = _NOTE.size_bytes


class FrameSlots:
    """Either side's view of one stream's memory."""

    def __init__(self, fd: int, payload_bytes: int) -> None:
        self._payload_bytes = payload_bytes
        self._memory = mmap.mmap(fd, _size(payload_bytes))
        self._view = memoryview(self._memory)
        self._use_counts = _USE_COUNTS.view(self._memory)
        self._counters = _COUNTERS.view(self._memory)
        self._claimed = 0

    @staticmethod
    def allocate(payload_bytes: int) -> int:
        """Descriptor of fresh memory for frames of that size."""
        fd = os.memfd_create("basler_stereo")
        os.ftruncate(fd, _size(payload_bytes))
        return fd

    def claim(self) -> tuple[int, memoryview]:
        """The least recently written slot, to be overwritten: its number and memory."""
        self._claimed += 1
        slot = self._claimed % SLOTS
        self._use_counts[slot] = self._claimed
        begin = _DATA_AT + slot * self._payload_bytes
        return slot, self._view[begin : begin + self._payload_bytes]

    def note(self, frame: Frame) -> bytes:
        """A finished frame's note for the reader."""
        return _NOTE.pack(
            _FrameNote(
                frame.slot,
                self._use_counts[frame.slot],
                frame.block_id,
                frame.missing_packets,
                frame.leader,
            )
        )

    def fetch(self, note: bytes) -> Frame | None:
        """A copy of the frame, or None if newer ones have overwritten it."""
        slot, use_count, block_id, missing, leader = _NOTE.unpack(note)
        if self._use_counts[slot] != use_count:
            return None
        begin = _DATA_AT + slot * self._payload_bytes
        data = bytearray(self._view[begin : begin + self._payload_bytes])
        if self._use_counts[slot] != use_count:
            return None
        return Frame(block_id, leader, data, missing)

    def write_counters(self, counters: StreamCounters) -> None:
        """Publish the counters to the other side."""
        for index, count in enumerate(vars(counters).values()):
            self._counters[index] = count

    def counters(self) -> StreamCounters:
        """The counters published by the other side."""
        return StreamCounters(*self._counters)


def _size(payload_bytes: int) -> int:
    return _DATA_AT + SLOTS * payload_bytes
