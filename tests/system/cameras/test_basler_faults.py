"""Every fault of the cameras, switched on in running simulators, and what a client sees of it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from coded_errors import raises
from faulty_cameras import AREA, LIMIT_S

from drivers.basler_stereo import BaslerStereoPair
from drivers.basler_stereo.errors import (
    PACKET_TOO_LARGE,
    WRONG_SERIAL,
    CameraLost,
    ControlLost,
    NoCamera,
    TriggerMissed,
)
from drivers.basler_stereo.identity import discover_cameras
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, Validity
from ronna_hw.host.network import find_interface

RAMP = np.add.outer(
    np.arange(AREA.offset_y, AREA.offset_y + AREA.height),
    np.arange(AREA.offset_x, AREA.offset_x + AREA.width),
).astype(np.uint8)
STALLS = 2  # of a busy computer, each longer than the driver waits for the second image
SILENT_SIDE_S = 5.0  # waited for in vain; the other side needs its time on a busy computer


def grab_on(pair: BaslerStereoPair) -> None:
    deadline_s = time.monotonic() + 30.0
    while time.monotonic() < deadline_s:
        pair.grab_pair(1.0)


@pytest.mark.parametrize(
    "phrase", ["lose left 10 %", "omit leader left", "omit trailer left", "omit frames left"]
)
def test_lost_packets_are_resent(cameras, phrase):
    pair = cameras.streaming(packet_bytes=1500)
    cameras.show_ramp(pair)
    cameras.fault(phrase)
    reading = pair.grab_pair(LIMIT_S)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, RAMP)
    assert np.array_equal(reading.right.pixels, RAMP)
    assert pair.counters[0].resend_requests > 0


@pytest.mark.parametrize("phrase", ["shuffle both", "duplicate both 50 %"])
def test_reordered_and_duplicate_packets_change_nothing(cameras, phrase):
    pair = cameras.streaming(packet_bytes=1500)
    cameras.show_ramp(pair)
    cameras.fault(phrase)
    reading = pair.grab_pair(LIMIT_S)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, RAMP)
    if phrase.startswith("duplicate"):
        assert pair.counters[0].duplicates > 0


@pytest.mark.hazard(25)
def test_packets_the_camera_has_forgotten_leave_a_partial_image(cameras):
    pair = cameras.streaming(packet_bytes=1500)
    cameras.fault("lose right 10 %")
    cameras.fault("forget right")
    readings = (pair.grab_pair(LIMIT_S) for _ in range(STALLS + 1))
    reading = next(reading for reading in readings if reading.validity is not Validity.MISSING)
    assert reading.validity is Validity.PARTIAL
    assert (reading.left.validity, reading.right.validity) == (Validity.OK, Validity.PARTIAL)
    assert reading.right.missing_packets > 0


def test_a_frame_lost_for_good_leaves_its_partner_intact(cameras):
    pair = cameras.streaming()
    cameras.fault("omit frames left")
    cameras.fault("forget left")
    reading = pair.grab_pair(SILENT_SIDE_S)
    assert (reading.validity, reading.left) == (Validity.MISSING, None)
    assert reading.right.validity is Validity.OK
    cameras.heal()
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.observe().says == (Fact("unusable pairs", "1"),)


@pytest.mark.hazard(25)
def test_a_leader_with_another_area_makes_the_image_corrupt(cameras):
    pair = cameras.streaming()
    cameras.fault("shift area left")
    reading = pair.grab_pair(LIMIT_S)
    assert (reading.validity, reading.left.validity) == (Validity.CORRUPT, Validity.CORRUPT)
    assert reading.right.validity is Validity.OK


def test_images_with_half_of_their_data_are_not_a_complete_pair(cameras):
    pair = cameras.streaming()
    cameras.fault("truncate left")
    assert pair.grab_pair(LIMIT_S).validity in (Validity.PARTIAL, Validity.MISSING)


@pytest.mark.hazard(25)
def test_a_camera_that_misses_a_trigger_leaves_the_other_unpaired(cameras):
    pair = cameras.streaming()
    cameras.fault("miss triggers right")
    reading = pair.grab_pair(SILENT_SIDE_S)
    assert (reading.validity, reading.right) == (Validity.MISSING, None)
    cameras.heal()
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.block_ids == (1, 1)


def test_a_trigger_that_reaches_no_camera_is_reported(cameras):
    pair = cameras.streaming()
    cameras.fault("miss triggers both")
    with pytest.raises(TriggerMissed, match=r"GEV-013.*'no image' from both cameras\. Reconnect"):
        pair.grab_pair(2.0)
    assert pair.state is Lifecycle.ACTIVE
    cameras.heal()
    cameras.fault("miss triggers both for 0.5 s")  # the second of two triggers is taken
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_images_lost_in_the_network_are_distinguished_from_missed_triggers(cameras):
    pair = cameras.streaming(resend=False)
    cameras.fault("omit frames both")
    with pytest.raises(TriggerMissed, match=r"GEV-013.*got no packets.*firewall"):
        pair.grab_pair(2.0)


@pytest.mark.parametrize("which", ["left", "both"])  # not of one moment; both older than their trigger
def test_a_restarted_camera_clock_is_detected_and_resynchronized(cameras, which):
    pair = cameras.streaming()
    for _ in range(2):
        assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.block_ids == (2, 2)
    cameras.fault(f"reset clock {which}")
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.block_ids == (1, 1)  # the pair was no pair, and the streams were begun anew


def test_a_clock_with_realistic_drift_keeps_the_pair_and_a_wild_one_does_not(cameras):
    pair = cameras.streaming()
    cameras.fault("drift left +100 ppm")
    assert all(pair.grab_pair(LIMIT_S).validity is Validity.OK for _ in range(3))
    cameras.heal()
    cameras.fault("drift left +900000 ppm")
    time.sleep(0.2)  # what has to pass is time
    assert pair.block_ids == (3, 3)
    pair.grab_pair(LIMIT_S)
    assert pair.block_ids[0] < 3  # a pair was not of one moment, and the streams were begun anew


@pytest.mark.hazard(4)
def test_a_camera_off_the_network_is_lost_and_recovered(cameras):
    pair = cameras.streaming()
    cameras.fault("unplug right")
    with pytest.raises(CameraLost, match="GEV-014"):
        pair.grab_pair(LIMIT_S)
    assert pair.state is Lifecycle.FAULT
    cameras.heal()
    pair.recover("a tester", LIMIT_S)
    pair.activate(LIMIT_S)
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK


@pytest.mark.hazard(4)
def test_an_absence_shorter_than_the_heartbeat_needs_no_recovery(cameras):
    pair = cameras.streaming(heartbeat_ms=10_000)
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    cameras.fault("unplug both")
    time.sleep(0.8)  # beats go unanswered meanwhile
    cameras.heal()
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.block_ids == (2, 2)
    assert pair.state is Lifecycle.ACTIVE


@pytest.mark.hazard(4)
def test_an_absence_that_begins_during_a_grab_only_costs_time(cameras):
    pair = cameras.streaming(heartbeat_ms=10_000)
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    cameras.fault("unplug right for 2 s")  # longer than a command is repeated
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.block_ids == (1, 1)  # the streams were begun anew
    assert pair.state is Lifecycle.ACTIVE


@pytest.mark.slow
@pytest.mark.hazard(4)
def test_an_absence_that_begins_while_areas_are_set_only_costs_time(cameras):
    pair = cameras.streaming(heartbeat_ms=10_000)
    part = AreaOfInterest(896, 416, 128, 128)
    cameras.fault("unplug right for 2 s")
    pair.set_areas(AREA, part, LIMIT_S)
    reading = pair.grab_pair(LIMIT_S)
    assert (reading.left.area, reading.right.area) == (AREA, part)
    assert pair.state is Lifecycle.ACTIVE


def test_both_cameras_are_found_by_broadcast_discovery(cameras):
    found = {each.address: each.serial for each in discover_cameras(find_interface("127.0.0.1"))}
    assert {address: found.get(address) for address in cameras.addresses} == dict(
        zip(cameras.addresses, ("21904411", "21904412"), strict=True)
    )


def test_a_broadcast_says_which_process_has_each_camera(cameras):
    found = {each.address: each.info for each in discover_cameras(find_interface("127.0.0.1"))}
    owners = {found[address] for address in cameras.addresses}
    assert owners == {f"ronna-sim, process {cameras.pid}"}


def test_when_a_camera_is_another_the_message_says_where_the_right_one_is(cameras):
    pair = cameras.new_pair(left_serial="21904412", right_serial="21900000")
    left = cameras.addresses[0]
    with raises(WRONG_SERIAL, match=rf"expected 21904412.*21904411 at {left}.*21904412 at "):
        pair.connect(1.0)


def test_when_one_camera_is_not_found_the_other_is_named(cameras):
    cameras.fault("unplug left")
    with pytest.raises(NoCamera, match=rf"{cameras.addresses[0]}; .*21904412 at {cameras.addresses[1]}"):
        cameras.new_pair().connect(1.0)


@pytest.mark.parametrize("phrase", ["restart left", "seize left"])
def test_losing_control_of_a_camera_is_reported(cameras, phrase):
    pair = cameras.streaming()
    cameras.fault(phrase)
    with pytest.raises(ControlLost, match="GEV-015"):
        grab_on(pair)
    assert pair.state is Lifecycle.FAULT


def test_ignored_heartbeats_end_control(cameras):
    pair = cameras.streaming(heartbeat_ms=500)
    cameras.fault("ignore heartbeat left")
    with pytest.raises(ControlLost, match="GEV-015"):
        grab_on(pair)


def test_the_packet_size_is_what_the_path_carries(cameras):
    cameras.fault("narrow path both 2000 bytes")
    wide = cameras.new_pair(packet_bytes=8000)
    wide.connect(LIMIT_S)
    with raises(PACKET_TOO_LARGE, match="GEV-012"):
        wide.configure(LIMIT_S)
    wide.close()
    pair = cameras.streaming()
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    packets = -(-AREA.width * AREA.height // (1500 - 36)) + 2
    # On a computer that stalls, a packet may be asked for that was only late: it then comes
    # twice, or the camera answers that it has not got it yet.
    once = [each.packets - each.duplicates - each.ignored - each.refusals for each in pair.counters]
    assert once == [packets, packets]
