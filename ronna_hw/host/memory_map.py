"""Locations in one block of shared memory, assigned in order: none overlap, no offset is written by hand.

Each location has one writer. Single words are aligned and need nothing more. A checked row or text has a
checksum: a reader that finds a half-written one retries; no one waits for the other side.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, Generic

from ronna_hw.host.shared_layout import RowCodec, RowT

ALIGNMENT_BYTES = 8
_CHECKSUM = struct.Struct("<I")
_LENGTH = struct.Struct("<I")


class Word:
    """One number; an aligned word is never read half-written."""

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


class Rows(Generic[RowT]):
    """Plain rows of one type, in sequence; `index` 0 for a single one."""

    def __init__(self, row: type[RowT], offset: int, count: int) -> None:
        self._codec = RowCodec(row)
        self._stride = _aligned(self._codec.size_bytes)
        self._offset = offset
        self.count = count
        self.size_bytes = self._stride * count

    def read(self, memory: Any, index: int = 0) -> RowT:
        return self._codec.unpack_from(memory, self._offset + index * self._stride)

    def write(self, memory: Any, row: RowT, index: int = 0) -> None:
        offset = self._offset + index * self._stride
        memory[offset : offset + self._codec.size_bytes] = self._codec.pack(row)


class CheckedRow(Generic[RowT]):
    """One row behind a checksum."""

    def __init__(self, row: type[RowT], offset: int) -> None:
        self._codec = RowCodec(row)
        self._block = _Checked(offset, self._codec.size_bytes)
        self.size_bytes = _CHECKSUM.size + self._codec.size_bytes

    def read(self, memory: Any) -> RowT | None:
        """The row; None while it is being written."""
        payload = self._block.read(memory)
        return None if payload is None else self._codec.unpack(payload)

    def write(self, memory: Any, row: RowT) -> None:
        self._block.write(memory, self._codec.pack(row))


class CheckedBytes:
    """Bytes of variable length behind a checksum."""

    def __init__(self, offset: int, capacity_bytes: int) -> None:
        self._offset = offset
        self.capacity_bytes = capacity_bytes
        self.size_bytes = _LENGTH.size + _CHECKSUM.size + capacity_bytes

    def read(self, memory: Any) -> bytes | None:
        """The bytes; None while they are being written."""
        length = _LENGTH.unpack_from(memory, self._offset)[0]
        return _Checked(self._offset + _LENGTH.size, min(length, self.capacity_bytes)).read(memory)

    def write(self, memory: Any, content: bytes) -> None:
        """Raises ValueError if they do not fit."""
        if len(content) > self.capacity_bytes:
            raise ValueError(f"{len(content)} bytes do not fit into {self.capacity_bytes}")
        memory[self._offset : self._offset + _LENGTH.size] = _LENGTH.pack(len(content))
        _Checked(self._offset + _LENGTH.size, len(content)).write(memory, content)


class _Checked:
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
    """A row of counters, accessed as one typed view of the memory."""

    def __init__(self, offset: int, count: int) -> None:
        self._offset = offset
        self.size_bytes = count * ALIGNMENT_BYTES

    def view(self, memory: Any) -> memoryview[int]:
        """Unsigned 64-bit counters; release the view before the memory is closed."""
        with memoryview(memory) as whole, whole[self._offset : self._offset + self.size_bytes] as bytes_:
            return bytes_.cast("Q")


class Bytes:
    """Plain bytes, laid out by the caller."""

    def __init__(self, offset: int, size_bytes: int) -> None:
        self.offset = offset
        self.size_bytes = size_bytes


class MemoryMap:
    """Begins with a mark that identifies the owner. `size_bytes` grows with every location assigned."""

    def __init__(self, mark: bytes) -> None:
        self.mark = mark
        self.size_bytes = _aligned(len(mark))

    def mark_memory(self, memory: Any) -> None:
        """Write our mark."""
        memory[: len(self.mark)] = self.mark

    def is_marked(self, memory: Any) -> bool:
        """Whether the memory carries our mark."""
        return bool(memory[: len(self.mark)] == self.mark)

    def word(self, code: str = "Q") -> Word:
        """One number of a struct code, aligned."""
        return Word(code, self._take(ALIGNMENT_BYTES))

    def rows(self, row: type[RowT], count: int = 1) -> Rows[RowT]:
        """`count` plain rows."""
        place = Rows(row, self.size_bytes, count)
        self._take(place.size_bytes)
        return place

    def checked(self, row: type[RowT]) -> CheckedRow[RowT]:
        """One row behind a checksum."""
        place = CheckedRow(row, self.size_bytes)
        self._take(place.size_bytes)
        return place

    def checked_bytes(self, capacity_bytes: int) -> CheckedBytes:
        """Bytes of variable length behind a checksum."""
        place = CheckedBytes(self.size_bytes, capacity_bytes)
        self._take(place.size_bytes)
        return place

    def counters(self, count: int) -> Counters:
        """A row of unsigned 64-bit counters."""
        place = Counters(self.size_bytes, count)
        self._take(place.size_bytes)
        return place

    def plain_bytes(self, size_bytes: int) -> Bytes:
        """Plain bytes."""
        return Bytes(self._take(size_bytes), size_bytes)

    def _take(self, size_bytes: int) -> int:
        offset = self.size_bytes
        self.size_bytes = _aligned(offset + size_bytes)
        return offset


def _aligned(size_bytes: int) -> int:
    return -(-size_bytes // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
