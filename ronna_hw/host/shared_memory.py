"""Shared-memory block with allocated locations, tables of rows, and a byte ring.

None of the locations overlap, and no offset is written by hand. Each has one writer. Single words are aligned
and need nothing more. A checked row or text has a checksum: a reader that finds it half written retries, and
nobody waits for the other side.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, Generic, NamedTuple, TypeVar

from ronna_hw.host.row_codec import RowCodec, RowT

ALIGNMENT_BYTES = 8
_CHECKSUM = struct.Struct("<I")
_LENGTH = struct.Struct("<I")
PlaceT = TypeVar("PlaceT", bound="SharedRows[Any] | CheckedRow[Any] | CheckedBytes | Counters")


class MemoryMap:
    """Allocator for locations in a block that begins with its owner's mark.

    `size_bytes` grows with every location.
    """

    def __init__(self, mark: bytes) -> None:
        self.mark = mark
        self.size_bytes = _align(len(mark))

    def mark_memory(self, memory: Any) -> None:
        """Write the owner's mark."""
        memory[: len(self.mark)] = self.mark

    def is_marked(self, memory: Any) -> bool:
        """Return whether the memory carries the owner's mark."""
        return bool(memory[: len(self.mark)] == self.mark)

    def word(self, code: str = "Q") -> Word:
        """Allocate an aligned number with a struct code."""
        return Word(code, self._take(ALIGNMENT_BYTES))

    def rows(self, row: type[RowT], count: int = 1) -> SharedRows[RowT]:
        """Allocate `count` plain rows."""
        return self._keep(SharedRows(row, self.size_bytes, count))

    def checked_row(self, row: type[RowT]) -> CheckedRow[RowT]:
        """Allocate a checksummed row."""
        return self._keep(CheckedRow(row, self.size_bytes))

    def checked_bytes(self, capacity_bytes: int) -> CheckedBytes:
        """Allocate checksummed bytes of variable length."""
        return self._keep(CheckedBytes(self.size_bytes, capacity_bytes))

    def counters(self, count: int) -> Counters:
        """Allocate a row of unsigned 64-bit counters."""
        return self._keep(Counters(self.size_bytes, count))

    def plain_bytes(self, size_bytes: int) -> Bytes:
        """Allocate plain bytes."""
        return Bytes(self._take(size_bytes), size_bytes)

    def _keep(self, place: PlaceT) -> PlaceT:
        self._take(place.size_bytes)
        return place

    def _take(self, size_bytes: int) -> int:
        offset = self.size_bytes
        self.size_bytes = _align(offset + size_bytes)
        return offset


def _align(size_bytes: int) -> int:
    return -(-size_bytes // ALIGNMENT_BYTES) * ALIGNMENT_BYTES


class Word:
    """Aligned number that is never read half-written."""

    def __init__(self, code: str, offset: int) -> None:
        self._struct = struct.Struct(f"<{code}")
        self.offset = offset
        self._place = slice(offset, offset + self._struct.size)

    def read(self, memory: Any) -> int:
        number: int = self._struct.unpack_from(memory, self.offset)[0]
        return number

    def write(self, memory: Any, number: int) -> None:
        # One copy. `pack_into` first fills the place with zeros, which another process then reads.
        memory[self._place] = self._struct.pack(number)


class SharedRows(Generic[RowT]):
    """Sequence of plain rows of one type; use `index` 0 for a single row."""

    def __init__(self, row: type[RowT], offset: int, count: int) -> None:
        self._codec = RowCodec(row)
        self.stride = _align(self._codec.size_bytes)
        self._offset = offset
        self.count = count
        self.size_bytes = self.stride * count

    def read(self, memory: Any, index: int = 0) -> RowT:
        return self._codec.unpack_from(memory, self._offset + index * self.stride)

    def copy(self, memory: Any) -> bytes:
        """Copy all rows, packed, one each `stride` bytes."""
        return bytes(memory[self._offset : self._offset + self.size_bytes])

    def write(self, memory: Any, row: RowT, index: int = 0) -> None:
        offset = self._offset + index * self.stride
        memory[offset : offset + self._codec.size_bytes] = self._codec.pack(row)


class CheckedRow(Generic[RowT]):
    """Row protected by a checksum."""

    def __init__(self, row: type[RowT], offset: int) -> None:
        self._codec = RowCodec(row)
        self._block = _ChecksummedBlock(offset, self._codec.size_bytes)
        self.size_bytes = _CHECKSUM.size + self._codec.size_bytes

    def read(self, memory: Any) -> RowT | None:
        """Read the row, or return None while it is being written."""
        payload = self._block.read(memory)
        return None if payload is None else self._codec.unpack(payload)

    def write(self, memory: Any, row: RowT) -> None:
        self._block.write(memory, self._codec.pack(row))


class CheckedBytes:
    """Bytes of variable length protected by a checksum."""

    def __init__(self, offset: int, capacity_bytes: int) -> None:
        self._offset = offset
        self.capacity_bytes = capacity_bytes
        self.size_bytes = _LENGTH.size + _CHECKSUM.size + capacity_bytes

    def read(self, memory: Any) -> bytes | None:
        """Read the bytes, or return None while they are being written."""
        length = _LENGTH.unpack_from(memory, self._offset)[0]
        return _ChecksummedBlock(self._offset + _LENGTH.size, min(length, self.capacity_bytes)).read(memory)

    def write(self, memory: Any, content: bytes) -> None:
        """Write the bytes; raises ValueError if they do not fit."""
        if len(content) > self.capacity_bytes:
            raise ValueError(f"{len(content)} bytes do not fit into {self.capacity_bytes}")
        memory[self._offset : self._offset + _LENGTH.size] = _LENGTH.pack(len(content))
        _ChecksummedBlock(self._offset + _LENGTH.size, len(content)).write(memory, content)


class _ChecksummedBlock:
    def __init__(self, offset: int, size_bytes: int) -> None:
        self._offset = offset
        self._start = offset + _CHECKSUM.size
        self._end = self._start + size_bytes

    def read(self, memory: Any) -> bytes | None:
        block = memory[self._offset : self._end]
        payload: bytes = block[_CHECKSUM.size :]
        return payload if zlib.crc32(payload) == _CHECKSUM.unpack_from(block)[0] else None

    def write(self, memory: Any, payload: bytes) -> None:
        memory[self._offset : self._end] = _CHECKSUM.pack(zlib.crc32(payload)) + payload


class Counters:
    """Row of counters, accessed as one typed view of the memory."""

    def __init__(self, offset: int, count: int) -> None:
        self._offset = offset
        self.size_bytes = count * ALIGNMENT_BYTES

    def view(self, memory: Any) -> memoryview[int]:
        """Return a view of unsigned 64-bit counters; release it before the memory is closed."""
        with memoryview(memory) as whole, whole[self._offset : self._offset + self.size_bytes] as bytes_:
            return bytes_.cast("Q")


class Bytes:
    """Plain bytes whose layout the user chooses."""

    def __init__(self, offset: int, size_bytes: int) -> None:
        self.offset = offset
        self.size_bytes = size_bytes


class RingPart(NamedTuple):
    """Result of a single read from a byte ring."""

    content: bytes
    end: int  # where to continue
    lost: int  # bytes overwritten before they were read


class ByteRing:
    """Byte ring for a writer that never waits and a reader that may fall behind.

    Entries follow each other without gaps; the reader finds their ends in the entries themselves. An
    overtaken reader skips what it missed and learns how much that was. `longest` is the longest entry: the
    writer may be within one during a read.
    """

    def __init__(self, written: Word, place: Bytes, longest: int) -> None:
        """Create a view; `written` counts all bytes ever written."""
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
        """Read everything from `begin` on: 0, or the end of the previous part."""
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
