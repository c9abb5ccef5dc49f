"""Packets, images and triggers that get lost: repaired where they can be, named where they cannot."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from peer_cameras import FULL, HANG_LIMIT_S, pattern

from drivers.basler_stereo.errors import TriggerMissed
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.readings import Validity


def test_lost_packets_are_asked_for_again(make_pair, peers):
    device = make_pair(packet_bytes=576)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    peers[0].fault("drop", 0, 5, 6, 40, 62)  # the leader and the trailer are 0 and 62
    reading = device.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, pattern(FULL, 1) & 0xFF)
    assert device.counters[0].resend_requests >= 4  # a busy computer asks more often


def test_an_image_of_which_every_packet_was_lost_is_asked_for(make_pair, peers):
    device = make_pair()
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    peers[0].fault("drop", *range(7))  # leader, five payload packets, trailer
    reading = device.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, pattern(FULL, 1) & 0xFF)


@pytest.mark.hazard(25)
def test_packets_that_are_gone_make_a_partial_reading(make_pair, peers):
    device = make_pair(packet_bytes=576)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    peers[1].fault("refuse-resend")
    peers[1].fault("drop", 3, 4)
    reading = device.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.PARTIAL
    assert reading.left.validity is Validity.OK
    assert (reading.right.validity, reading.right.missing_packets) == (Validity.PARTIAL, 2)
    peers[1].fault("normal")
    assert device.grab_pair(HANG_LIMIT_S).validity is Validity.OK


@pytest.mark.hazard(25)
def test_a_leader_that_tells_of_another_area_makes_a_corrupt_reading(pair, peers):
    peers[0].fault("wrong-area")
    reading = pair.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.CORRUPT
    assert reading.right.validity is Validity.OK


@pytest.mark.hazard(25)
def test_a_side_that_sends_no_image_is_missing_and_the_next_pair_is_in_step(pair, peers):
    peers[0].fault("no-frames")
    reading = pair.grab_pair(5.0)  # what is waited for the side that is silent; the other needs its time
    assert reading.validity is Validity.MISSING
    assert reading.left is None
    assert reading.right.validity is Validity.OK
    peers[0].fault("normal")
    reading = pair.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, pattern(FULL, 1) & 0xFF)
    assert np.array_equal(reading.right.pixels, pattern(FULL, 1) & 0xFF)


def test_no_image_from_either_side_is_a_missed_trigger(pair, peers):
    for peer in peers:
        peer.fault("no-frames")
    with pytest.raises(TriggerMissed, match="GEV-013"):
        pair.grab_pair(0.3)
    assert pair.state is Lifecycle.ACTIVE
    for peer in peers:
        peer.fault("normal")
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK


def test_a_trigger_without_any_image_is_repeated_once(pair, peers):
    for peer in peers:
        peer.fault("no-frames")

    def speak_again() -> None:
        for peer in peers:
            peer.fault("normal")

    timer = threading.Timer(1.0, speak_again)
    timer.start()
    reading = pair.grab_pair(6.0)
    timer.join()
    assert reading.validity is Validity.OK
    assert [peer.fault("count") for peer in peers] == ["2 DONE\n", "2 DONE\n"]


def test_a_stream_that_stops_in_the_middle_is_given_up_within_the_limit(pair, peers):
    peers[0].fault("mute-stream")
    peers[0].fault("refuse-resend")
    start_s = time.monotonic()
    reading = pair.grab_pair(3.0)
    assert reading.validity in (Validity.PARTIAL, Validity.MISSING)
    assert time.monotonic() - start_s < HANG_LIMIT_S
