"""Frames through shared memory: complete, or known to be overwritten."""

from __future__ import annotations

import os

import pytest

from drivers.basler_stereo.stream.frame_assembler import Frame, Leader, StreamCounters
from drivers.basler_stereo.stream.receiver_interface import SLOTS, FrameSlots

PAYLOAD = 5000
LEADER = Leader(2**40 + 7, 0x01080001, 16, 8, 100, 50, 0)


@pytest.fixture
def sides():
    descriptor = FrameSlots.allocate(PAYLOAD)
    yield FrameSlots(descriptor, PAYLOAD), FrameSlots(descriptor, PAYLOAD)
    os.close(descriptor)


def written(slots: FrameSlots, block_id: int, leader: Leader | None = LEADER) -> bytes:
    number, memory = slots.claim()
    memory[:] = bytes([block_id]) * PAYLOAD
    return slots.note(Frame(block_id, leader, memory, 2, number))


def test_a_frame_is_fetched_as_it_was_written(sides):
    writer, reader = sides
    frame = reader.fetch(written(writer, 9))
    assert (frame.block_id, frame.leader, frame.missing_packets) == (9, LEADER, 2)
    assert bytes(frame.data) == bytes([9]) * PAYLOAD


def test_a_frame_without_a_leader_is_fetched_without_one(sides):
    writer, reader = sides
    assert reader.fetch(written(writer, 1, leader=None)).leader is None


def test_frames_are_kept_until_their_slot_is_needed(sides):
    writer, reader = sides
    notes = [written(writer, block_id) for block_id in range(1, SLOTS + 1)]
    assert [reader.fetch(note).block_id for note in notes] == list(range(1, SLOTS + 1))
    writer.claim()
    assert reader.fetch(notes[0]) is None
    assert reader.fetch(notes[1]).block_id == 2


def test_a_copy_is_not_changed_by_later_frames(sides):
    writer, reader = sides
    frame = reader.fetch(written(writer, 1))
    for block_id in range(2, 2 * SLOTS):
        written(writer, block_id)
    assert bytes(frame.data) == bytes([1]) * PAYLOAD


def test_counters_are_visible_to_the_other_side(sides):
    writer, reader = sides
    writer.write_counters(StreamCounters(1, 2, 3, 4, 5, 6, 7))
    assert reader.counters() == StreamCounters(1, 2, 3, 4, 5, 6, 7)
