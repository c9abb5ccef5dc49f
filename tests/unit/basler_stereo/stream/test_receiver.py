"""Frames pass through shared memory complete, or known to be overwritten; foreign packets are dropped."""

from __future__ import annotations

import contextlib
import os
import socket

import pytest

from drivers.basler_stereo.stream.frame_assembler import Leader, ReceivedImage, StreamCounters
from drivers.basler_stereo.stream.receiver import await_packet, open_stream_socket
from drivers.basler_stereo.stream.receiver_interface import SLOTS, FrameSlots, OpenImageStream
from drivers.basler_stereo.stream.receiver_process import _Stream
from ronna_hw.wire import gige_vision as gev

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
    return slots.note(ReceivedImage(block_id, leader, memory, 2, number))


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


HOST, CAMERA, STRANGER = "127.0.0.1", "127.0.0.2", "127.0.0.3"
PAYLOAD_BYTES, PACKET_BYTES = 1200, 136


def sender(address: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((address, 0))
    return made


def test_packets_from_another_address_than_the_cameras_are_dropped_and_counted() -> None:
    memory = FrameSlots.allocate(PAYLOAD_BYTES)
    slots = FrameSlots(memory, PAYLOAD_BYTES)
    ours, notes = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    control = sender(HOST)
    with ours, sender(CAMERA) as camera, sender(STRANGER) as stranger:
        control.connect(camera.getsockname())
        images = open_stream_socket(HOST, 1 << 20)
        to = images.getsockname()
        descriptors = [images.detach(), control.detach(), memory, notes.detach()]
        stream = _Stream(OpenImageStream(1, PAYLOAD_BYTES, PACKET_BYTES, resend=False), descriptors)
        with contextlib.closing(stream):
            for one in (stranger, stranger, camera):
                one.sendto(bytes(100), to)
            buffer = bytearray(1000)
            stream.receive(buffer, memoryview(buffer))
    counters = slots.counters()
    assert (counters.foreign, counters.packets) == (2, 1)


def test_a_test_packet_from_another_address_than_the_cameras_is_none() -> None:
    with open_stream_socket(HOST, 1 << 20) as images, sender(STRANGER) as stranger:
        stranger.sendto(bytes(PACKET_BYTES - gev.IP_UDP_HEADER_BYTES), images.getsockname())
        assert not await_packet(images, CAMERA, PACKET_BYTES, 0.0)
        stranger.sendto(bytes(PACKET_BYTES - gev.IP_UDP_HEADER_BYTES), images.getsockname())
        assert await_packet(images, STRANGER, PACKET_BYTES, 0.0)
