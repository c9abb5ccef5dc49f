"""Frames from packets in any order, with losses, repeats and garbage."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.basler_stereo.stream.frame_assembler import (
    AFTER_TRAILER_S,
    OPEN_BLOCKS,
    PACKETS_PER_ROUND,
    RESEND_INTERVALS_S,
    FrameAssembler,
    decode_header,
    next_block_id,
)
from ronna_hw.devices.readings import AreaOfInterest

WIDTH, HEIGHT = 40, 30
PAYLOAD = WIDTH * HEIGHT
PACKET = 136  # 100 bytes of data: 12 payload packets, leader 0, trailer 13
IMAGE = random.Random(3).randbytes(PAYLOAD)


def packets(block_id=1, image=IMAGE, status=0):
    leader = struct.pack(">HHQIIIIIHH", 0, 1, 1000 + block_id, 0x01080001, WIDTH, HEIGHT, 16, 8, 0, 0)
    pieces = [image[start : start + 100] for start in range(0, len(image), 100)]
    contents = [(1, leader), *((3, piece) for piece in pieces), (2, struct.pack(">HHI", 0, 1, HEIGHT))]
    return [
        memoryview(struct.pack(">HHI", status, block_id, kind << 24 | number) + content)
        for number, (kind, content) in enumerate(contents)
    ]


def unavailable(block_id, number, status=0x800C):
    return memoryview(struct.pack(">HHI", status, block_id, 3 << 24 | number))


@pytest.fixture
def assembler():
    return FrameAssembler(PAYLOAD, PACKET)


def feed(assembler, given_packets, now_s=0.0):
    frames = [assembler.accept(packet, now_s) for packet in given_packets]
    return [frame for frame in frames if frame is not None]


def test_packets_in_order_make_the_image(assembler):
    (frame,) = feed(assembler, packets())
    assert bytes(frame.data) == IMAGE
    assert (frame.block_id, frame.missing_packets) == (1, 0)
    assert frame.leader.ticks == 1001
    assert frame.leader.area == AreaOfInterest(16, 8, WIDTH, HEIGHT)
    assert not assembler.is_waiting


@given(st.permutations(range(14)), st.lists(st.integers(0, 13), max_size=6))
def test_reordering_and_duplicates_do_not_matter(order, doubled):
    assembler = FrameAssembler(PAYLOAD, PACKET)
    all_packets = packets()
    sequence = [number for number in order for _ in range(1 + (number in doubled))]
    (frame,) = feed(assembler, [all_packets[number] for number in sequence])
    assert bytes(frame.data) == IMAGE


def test_missing_packets_are_requested_after_a_pause(assembler):
    all_packets = packets()
    assert feed(assembler, [p for i, p in enumerate(all_packets) if i not in (0, 4, 5, 13)], now_s=1.0) == []
    assert assembler.find_overdue(1.0 + 0.5 * RESEND_INTERVALS_S[0]) == ([], None)
    ranges, frame = assembler.find_overdue(1.0 + 1.01 * RESEND_INTERVALS_S[0])
    assert (ranges, frame) == ([(1, 0, 0), (1, 4, 5), (1, 13, 13)], None)
    again = packets(status=0x0100)
    (frame,) = feed(assembler, [again[0], again[4], again[5], again[13]], now_s=1.1)
    assert bytes(frame.data) == IMAGE


def test_the_pauses_grow_until_the_frame_is_given_up(assembler):
    feed(assembler, packets()[:-3])
    now_s, asked = 0.0, 0
    while True:
        now_s += 0.005
        ranges, frame = assembler.find_overdue(now_s)
        asked += bool(ranges)
        if frame is not None:
            break
    assert asked == len(RESEND_INTERVALS_S)
    assert frame.missing_packets == 2
    assert now_s == pytest.approx(sum(RESEND_INTERVALS_S) + RESEND_INTERVALS_S[-1], abs=0.05)
    assert bytes(frame.data[-200:]) == bytes(200)


def test_packets_that_the_camera_no_longer_has_end_the_wait(assembler):
    all_packets = packets()
    feed(assembler, [p for i, p in enumerate(all_packets) if i != 4])
    ranges, _ = assembler.find_overdue(0.03)
    assert ranges == [(1, 4, 4)]
    feed(assembler, [unavailable(1, 4)], now_s=0.03)
    _, frame = assembler.find_overdue(0.2)
    assert frame.missing_packets == 1


def test_unavailable_before_the_trailer_means_not_yet(assembler):
    all_packets = packets()
    feed(assembler, [*all_packets[:5], unavailable(1, 9)])
    (frame,) = feed(assembler, all_packets[5:])
    assert frame.missing_packets == 0


def test_a_frame_without_a_leader_is_delivered_without_one(assembler):
    feed(assembler, packets()[1:])
    now_s = 0.0
    frame = None
    while frame is None:
        now_s += 0.05
        _, frame = assembler.find_overdue(now_s)
    assert frame.leader is None


def test_a_few_blocks_may_be_open_and_one_more_pushes_out_the_oldest(assembler):
    begun = [packets(block_id) for block_id in range(1, OPEN_BLOCKS + 2)]
    assert feed(assembler, [packet for block in begun[:-1] for packet in block[:2]]) == []
    (pushed,) = feed(assembler, [begun[-1][0]])
    assert (pushed.block_id, pushed.missing_packets) == (1, 11)
    assert feed(assembler, begun[0][2:4]) == []  # too late: it is not opened again
    (frame,) = feed(assembler, begun[1][2:])
    assert (frame.block_id, frame.missing_packets) == (2, 0)


def test_missing_packets_are_requested_almost_at_once_after_the_trailer(assembler):
    feed(assembler, [packet for number, packet in enumerate(packets()) if number != 4])
    assert assembler.find_overdue(0.5 * AFTER_TRAILER_S) == ([], None)
    assert assembler.find_overdue(1.5 * AFTER_TRAILER_S) == ([(1, 4, 4)], None)


def test_missing_packets_are_requested_almost_at_once_when_the_next_block_has_begun(assembler):
    feed(assembler, [*packets()[:4], packets(2)[0]])
    assert assembler.find_overdue(1.5 * AFTER_TRAILER_S) == ([(1, 4, 13)], None)


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\0" * 7,
        struct.pack(">HHI", 0, 0, 3 << 24 | 1) + bytes(100),
        struct.pack(">HHI", 0, 1, 3 << 24 | 99) + bytes(100),
        struct.pack(">HHI", 0, 1, 3 << 24 | 1) + bytes(99),
        struct.pack(">HHI", 0, 1, 2 << 24 | 1) + bytes(100),
        struct.pack(">HHI", 0, 1, 3 << 24) + bytes(100),
        struct.pack(">HHI", 0, 1, 1 << 24) + bytes(10),
        struct.pack(">HHI", 0, 1, 1 << 24) + struct.pack(">HHQIIIIIHH", 0, 2, 0, 0, 0, 0, 0, 0, 0, 0),
        struct.pack(">HHI", 0, 1, 0x8000_0000 | 3 << 24 | 1) + bytes(100),
        struct.pack(">HHI", 0, 1, 9 << 24 | 1) + bytes(100),
    ],
)
def test_malformed_packets_are_counted_and_ignored(assembler, packet):
    assert assembler.accept(memoryview(packet), 0.0) is None
    assert assembler.counters.ignored == 1
    (frame,) = feed(assembler, packets())
    assert bytes(frame.data) == IMAGE


def test_block_ids_wrap_without_zero():
    assert [next_block_id(1), next_block_id(0xFFFE), next_block_id(0xFFFF)] == [2, 0xFFFF, 1]
    assert decode_header(packets(0xFFFF)[3]).block_id == 0xFFFF


def test_a_triggered_block_is_requested_when_nothing_of_it_arrived(assembler):
    assembler.expect(1, from_s=5.0)
    assert assembler.find_overdue(5.0) == ([], None)
    assert assembler.find_overdue(5.0 + 1.01 * RESEND_INTERVALS_S[0]) == ([(1, 0, 13)], None)
    (frame,) = feed(assembler, packets(status=0x0100), now_s=5.1)
    assert bytes(frame.data) == IMAGE
    assert not assembler.is_waiting


def test_a_triggered_block_is_not_given_up_before_a_newer_one_arrives(assembler):
    assembler.expect(1, from_s=0.0)
    now_s = 0.0
    for _ in range(3 * len(RESEND_INTERVALS_S)):
        now_s += 1.01 * RESEND_INTERVALS_S[-1]
        feed(assembler, [unavailable(1, 0)], now_s)
        assert assembler.find_overdue(now_s + 1.01 * RESEND_INTERVALS_S[-1])[1] is None
    newer = [packet for block_id in range(2, OPEN_BLOCKS + 3) for packet in packets(block_id)]
    assert [frame.block_id for frame in feed(assembler, newer)] == list(range(2, OPEN_BLOCKS + 3))


def test_missing_packets_leave_no_pixels_of_an_earlier_frame():
    memory = bytearray(b"\xff" * PAYLOAD)
    assembler = FrameAssembler(PAYLOAD, PACKET, lambda: (0, memory))
    feed(assembler, [packet for number, packet in enumerate(packets()) if number not in (4, 13)])
    for number in range(3 * len(RESEND_INTERVALS_S)):
        _, frame = assembler.find_overdue(1.0 + number)
        if frame is not None:
            break
    assert frame.missing_packets == 1
    assert bytes(frame.data) == IMAGE[:300] + bytes(100) + IMAGE[400:]


def test_an_answered_request_is_followed_by_the_next_almost_at_once():
    payload = bytes(100 * 3 * PACKETS_PER_ROUND)
    assembler = FrameAssembler(len(payload), PACKET)
    sent = packets(image=payload)
    again = packets(image=payload, status=0x0100)
    feed(assembler, [sent[0], sent[1], sent[-1]])
    now_s, first = 0.0, 2
    while assembler.is_waiting:
        now_s += 1.5 * AFTER_TRAILER_S
        ranges, given_up = assembler.find_overdue(now_s)
        last = min(first + PACKETS_PER_ROUND, 3 * PACKETS_PER_ROUND + 1) - 1
        assert (ranges, given_up) == ([(1, first, last)], None)
        feed(assembler, again[first : last + 1], now_s)
        first = last + 1
    assert assembler.counters.incomplete_frames == 0


def test_a_block_lost_entirely_between_two_others_is_requested(assembler):
    assert [frame.block_id for frame in feed(assembler, [*packets(1), *packets(3)])] == [1, 3]
    assert assembler.find_overdue(1.01 * RESEND_INTERVALS_S[0]) == ([(2, 0, 13)], None)
    (frame,) = feed(assembler, packets(2, status=0x0100))
    assert frame.block_id == 2


def test_a_distant_or_wrapped_block_id_triggers_no_request(assembler):
    for before, after in ((1, 5000), (5000, 2), (65535, 1)):
        feed(assembler, [*packets(before), *packets(after)])
        assert not assembler.is_waiting
