"""Frames in shared memory: written by the reception process, copied out by the driver.

The memory is anonymous and passed by its file descriptor, so nothing is left behind whoever dies. Frames take
turns over a few slots. Each slot carries the number of its present use: a reader compares it before and after
its copy, and sees that a frame was overwritten meanwhile. Nobody ever waits for the other side.
"""

from __future__ import annotations

import mmap
import os
import struct

from drivers.basler_stereo.stream.frame_assembler import Frame, StreamCounters
from drivers.basler_stereo.stream.gvsp import Leader

SLOTS = 32  # more than may be received at a time; the others are whole and wait a third of a second
_COUNTERS = struct.Struct("<7Q")
_WORD = struct.Struct("<Q")
_USES_AT = 64
_DATA_AT = mmap.PAGESIZE
# slot, its use, block id, missing and repeated packets, then the leader: there, ticks, format, area, padding
_NOTE = struct.Struct("<IQIIIBQIIIIIH")
NOTE_BYTES = _NOTE.size


class FrameSlots:
    """Either side's view of one stream's memory."""

    def __init__(self, fd: int, payload_bytes: int) -> None:
        self._payload_bytes = payload_bytes
        self._memory = mmap.mmap(fd, _size(payload_bytes))
        self._view = memoryview(self._memory)
        self._claimed = 0

    @staticmethod
    def allocate(payload_bytes: int) -> int:
        """Descriptor of fresh memory for frames of that size."""
        fd = os.memfd_create("basler_stereo")
        os.ftruncate(fd, _size(payload_bytes))
        return fd

    def claim(self) -> tuple[int, memoryview]:
        """The slot that was written longest ago, to be written anew: its number and its memory."""
        self._claimed += 1
        slot = self._claimed % SLOTS
        _WORD.pack_into(self._view, _USES_AT + slot * _WORD.size, self._claimed)
        begin = _DATA_AT + slot * self._payload_bytes
        return slot, self._view[begin : begin + self._payload_bytes]

    def note(self, frame: Frame) -> bytes:
        """What a reader must know to fetch a finished frame."""
        use = self._use(frame.slot)
        return _NOTE.pack(
            frame.slot,
            use,
            frame.block_id,
            frame.missing_packets,
            frame.resent_packets,
            frame.leader is not None,
            *(frame.leader or (0, 0, 0, 0, 0, 0, 0)),
        )

    def fetch(self, note: bytes) -> Frame | None:
        """A copy of the frame, or None when newer ones have overwritten it."""
        slot, use, block_id, missing, resent, led, *leader = _NOTE.unpack(note)
        if self._use(slot) != use:
            return None
        begin = _DATA_AT + slot * self._payload_bytes
        data = bytearray(self._view[begin : begin + self._payload_bytes])
        if self._use(slot) != use:
            return None
        return Frame(block_id, Leader(*leader) if led else None, data, missing, resent)

    def write_counters(self, counters: StreamCounters) -> None:
        """Show the counters to the other side."""
        _COUNTERS.pack_into(
            self._view,
            0,
            counters.packets,
            counters.ignored,
            counters.duplicates,
            counters.resend_requests,
            counters.frames,
            counters.incomplete_frames,
            counters.refusals,
        )

    def counters(self) -> StreamCounters:
        """What the other side has counted."""
        return StreamCounters(*_COUNTERS.unpack_from(self._view))

    def _use(self, slot: int) -> int:
        return int(_WORD.unpack_from(self._view, _USES_AT + slot * _WORD.size)[0])


def _size(payload_bytes: int) -> int:
    return _DATA_AT + SLOTS * payload_bytes
