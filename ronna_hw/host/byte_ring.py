"""A ring of bytes in shared memory: one writer that never waits, one reader that may be too late.

Entries follow each other without gaps; the reader finds their ends in the entries themselves. A reader that
was overtaken, or nearly, skips what it has missed and learns how much that was.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ronna_hw.host.memory_map import Bytes, Word


class RingPart(NamedTuple):
    """Result of one read."""

    content: bytes
    end: int  # where to continue
    lost: int  # bytes overwritten before they were read


class ByteRing:
    """`longest` is the longest entry: the writer may be within one during a read."""

    def __init__(self, written: Word, place: Bytes, longest: int) -> None:
        """`written` counts all bytes ever written."""
        self._written = written
        self._place = place
        self._longest = longest

    def write(self, memory: Any, entry: bytes) -> None:
        """Append an entry of at most `longest` bytes."""
        offset, capacity = self._place.offset, self._place.size_bytes
        total = self._written.read(memory)
        at = total % capacity
        fits = min(len(entry), capacity - at)
        memory[offset + at : offset + at + fits] = entry[:fits]
        if fits < len(entry):
            memory[offset : offset + len(entry) - fits] = entry[fits:]
        self._written.write(memory, total + len(entry))

    def read(self, memory: Any, begin: int) -> RingPart:
        """Everything since `begin`, which is 0 or the end of the last part."""
        offset, capacity = self._place.offset, self._place.size_bytes
        end = self._written.read(memory)
        if end - begin > capacity - self._longest:
            return RingPart(b"", end, end - begin)
        first, last = begin % capacity, end % capacity
        if first <= last:
            content = memory[offset + first : offset + last]
        else:
            content = memory[offset + first : offset + capacity] + memory[offset : offset + last]
        if self._written.read(memory) - begin > capacity - self._longest:  # overtaken in the meantime
            return RingPart(b"", end, end - begin)
        return RingPart(content, end, 0)
