"""Rows in shared memory are read back or noticed as half written; the entries of a ring stay intact."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
from enum import IntEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import pytest

from ronna_hw.host.row_codec import IPV4_HOST, one_of, text
from ronna_hw.host.shared_memory import ByteRing, MemoryMap
from ronna_hw.vectors import Vector3

ROOT = Path(__file__).resolve().parents[3]
SIDES = ("left", "right")


class Phase(IntEnum):
    IDLE = 0
    RUNNING = 1


class Sample(NamedTuple):
    number: Annotated[int, "Q"]
    phase: Annotated[Phase, "B"]
    ready: bool
    position_mm: Vector3
    side: Annotated[str, one_of(SIDES)]
    host: Annotated[str, IPV4_HOST]
    name: Annotated[str, text(16)]


def test_the_places_of_a_memory_map_do_not_overlap() -> None:
    places = MemoryMap(b"TESTMARK")
    word, counters, rows = places.word(), places.counters(3), places.rows(Sample, 2)
    content, row, last = places.checked_bytes(5), places.checked_row(Sample), places.word("I")
    memory = bytearray(places.size_bytes)
    first = Sample(1, Phase.RUNNING, True, (1.0, 2.0, 3.0), "right", "", "one")
    second = first._replace(number=2, name="two")
    word.write(memory, 2**64 - 1)
    with counters.view(memory) as view:
        view[0] = view[2] = 2**64 - 1
    rows.write(memory, first, 0)
    rows.write(memory, second, 1)
    content.write(memory, b"12345")
    row.write(memory, second)
    last.write(memory, 7)
    with counters.view(memory) as view:
        assert list(view) == [2**64 - 1, 0, 2**64 - 1]
    assert (word.read(memory), last.read(memory)) == (2**64 - 1, 7)
    assert (rows.read(memory, 0), rows.read(memory, 1), row.read(memory)) == (first, second, second)
    assert content.read(memory) == b"12345"


COUNTING = """
import mmap, sys
from ronna_hw.host.shared_memory import MemoryMap
places = MemoryMap(b"TESTMARK")
word = places.word()
memory = mmap.mmap(int(sys.argv[1]), places.size_bytes)
number = 0
while True:
    number += 1
    word.write(memory, number)
"""


def test_a_word_that_another_process_counts_up_is_never_read_as_less() -> None:
    places = MemoryMap(b"TESTMARK")
    word, file = places.word(), os.memfd_create("counted")
    os.ftruncate(file, places.size_bytes)
    counting = subprocess.Popen([sys.executable, "-c", COUNTING, str(file)], pass_fds=[file])
    with counting, mmap.mmap(file, places.size_bytes) as memory:
        last, reads, seen = 0, 0, 0
        while reads < 50_000 or seen < 200:
            number = word.read(memory)
            if number < last:
                break
            seen += number > last
            reads += number > 0
            last = number
        counting.kill()
    os.close(file)
    assert number >= last


def test_a_half_written_row_is_not_read() -> None:
    places = MemoryMap(b"TESTMARK")
    row, content = places.checked_row(Sample), places.checked_bytes(16)
    memory = bytearray(places.size_bytes)
    assert row.read(memory) is None
    row.write(memory, Sample(1, Phase.IDLE, False, (0.0, 0.0, 0.0), "left", "", ""))
    content.write(memory, b"surroundings")
    for offset in range(len(places.mark) + 8, places.size_bytes - 8, 8):
        torn = bytearray(memory)
        torn[offset] ^= 0xFF
        assert row.read(torn) is None or content.read(torn) is None


def test_more_bytes_than_fit_are_refused() -> None:
    places = MemoryMap(b"TESTMARK")
    content = places.checked_bytes(4)
    with pytest.raises(ValueError, match="5 bytes do not fit into 4"):
        content.write(bytearray(places.size_bytes), b"12345")


def test_memory_of_another_program_is_recognised_by_its_mark() -> None:
    places = MemoryMap(b"TESTMARK")
    assert places.is_marked(b"TESTMARK....")
    assert not places.is_marked(b"RONNARSI....")


def test_modules_with_shared_memory_leave_packing_to_its_tables() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "drivers").rglob("*.py")}
    sharing = {path for path, text in texts.items() if "MemoryMap(" in text}
    assert sharing
    assert not [path for path in sharing if "import struct" in texts[path]]


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
