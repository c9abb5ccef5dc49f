"""Camera registers: single words and memory blocks, each with its own read and write functions."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire.gige_vision import REGISTER_BYTES, GevStatus


class RegisterRefusal(Exception):
    """Register access refused with a status code after writing `written` bytes or registers."""

    def __init__(self, status: GevStatus, written: int = 0) -> None:
        super().__init__(status.name)
        self.status = status
        self.written = written


@dataclass(frozen=True)
class RegisterWord:
    """A 32-bit register, read-only if `write` is None; `write` raises RegisterRefusal for a bad value."""

    read: Callable[[], int]
    write: Callable[[int], None] | None = None


@dataclass(frozen=True)
class Memory:
    """A memory block whose size is a multiple of 4; `write` receives its whole new content."""

    address: int
    size: int
    read: Callable[[], bytes]
    write: Callable[[bytes], None] | None = None

    def content(self) -> bytes:
        """Return the content, zero-padded to the block size."""
        return self.read().ljust(self.size, b"\0")[: self.size]


class RegisterMap:
    """Register map of one camera, by address."""

    def __init__(self) -> None:
        self._words: dict[int, RegisterWord] = {}
        self._blocks: list[Memory] = []

    def add(self, address: int, word: RegisterWord) -> None:
        """Add a register; each address may be used only once."""
        if address % REGISTER_BYTES or address in self._words:
            raise ValueError(f"register address 0x{address:X} is odd or taken")
        self._words[address] = word

    def add_memory(self, block: Memory) -> None:
        """Add a block of memory."""
        self._blocks.append(block)
        self._blocks.sort(key=lambda each: each.address)

    def __contains__(self, address: int) -> bool:
        return address in self._words or self._find_block(address) is not None

    def read_word(self, address: int) -> int:
        """Read one register; raises RegisterRefusal."""
        _check_alignment(address)
        word = self._words.get(address)
        if word is not None:
            return word.read() & 0xFFFFFFFF
        block = self._find_block(address)
        if block is None:
            raise RegisterRefusal(GevStatus.INVALID_ADDRESS)
        offset = address - block.address
        return int.from_bytes(block.content()[offset : offset + REGISTER_BYTES], "big")

    def write_word(self, address: int, value: int) -> None:
        """Write one register; raises RegisterRefusal."""
        _check_alignment(address)
        word = self._words.get(address)
        if word is None:
            self._write_block(address, value.to_bytes(REGISTER_BYTES, "big"))
        elif word.write is None:
            raise RegisterRefusal(GevStatus.WRITE_PROTECT)
        else:
            word.write(value)

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes, across registers and blocks; raises RegisterRefusal."""
        _check_alignment(address, count)
        content = bytearray()
        while len(content) < count:
            here = address + len(content)
            block = None if here in self._words else self._find_block(here)
            if block is None:
                content += self.read_word(here).to_bytes(REGISTER_BYTES, "big")
            else:
                content += block.content()[here - block.address :][: count - len(content)]
        return bytes(content)

    def write(self, address: int, data: bytes) -> None:
        """Write bytes, register by register; raises RegisterRefusal with the bytes already written."""
        _check_alignment(address, len(data))
        done = 0
        while done < len(data):
            here = address + done
            block = None if here in self._words else self._find_block(here)
            try:
                if block is None:
                    self.write_word(here, int.from_bytes(data[done : done + REGISTER_BYTES], "big"))
                    done += REGISTER_BYTES
                else:
                    part = data[done : done + block.address + block.size - here]
                    self._write_block(here, part)
                    done += len(part)
            except RegisterRefusal as refusal:
                raise RegisterRefusal(refusal.status, done) from refusal

    def _write_block(self, address: int, data: bytes) -> None:
        block = self._find_block(address)
        if block is None:
            raise RegisterRefusal(GevStatus.INVALID_ADDRESS)
        if block.write is None:
            raise RegisterRefusal(GevStatus.WRITE_PROTECT)
        content, offset = block.content(), address - block.address
        block.write(content[:offset] + data + content[offset + len(data) :])

    def _find_block(self, address: int) -> Memory | None:
        index = bisect_right(self._blocks, address, key=lambda each: each.address) - 1
        if index >= 0 and address < self._blocks[index].address + self._blocks[index].size:
            return self._blocks[index]
        return None


def _check_alignment(address: int, count: int = 0) -> None:
    if address % REGISTER_BYTES or count % REGISTER_BYTES:
        raise RegisterRefusal(GevStatus.BAD_ALIGNMENT)
