"""The ring buffer between real-time process and driver: entries stay intact, lost ones are counted."""

import pytest

from ronna_hw.host.shared_memory import ByteRing, MemoryMap

CAPACITY, LONGEST = 64, 16


@pytest.fixture
def ring() -> tuple[ByteRing, bytearray]:
    layout = MemoryMap(b"TESTRING")
    made = ByteRing(layout.word(), layout.plain_bytes(CAPACITY), LONGEST)
    return made, bytearray(layout.size_bytes)


def test_entries_are_read_once_and_in_order_across_the_wrap_around(ring: tuple[ByteRing, bytearray]) -> None:
    entries, memory = ring
    at, heard = 0, b""
    said = b"".join(b"%03d;" % number for number in range(100))
    for number in range(100):
        entries.write(memory, b"%03d;" % number)
        if number % 7 == 0:
            content, at, lost = entries.read(memory, at)
            assert lost == 0
            heard += content
    heard += entries.read(memory, at).content
    assert heard == said


def test_an_overtaken_reader_continues_with_the_newest_entry_and_knows_how_much_it_lost(
    ring: tuple[ByteRing, bytearray],
) -> None:
    entries, memory = ring
    for _ in range(20):
        entries.write(memory, bytes(10))
    part = entries.read(memory, 0)
    assert (part.content, part.lost) == (b"", 200)
    entries.write(memory, b"after")
    assert entries.read(memory, part.end).content == b"after"
