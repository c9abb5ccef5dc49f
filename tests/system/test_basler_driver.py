"""The stereo driver against two small cameras in processes of their own, over real sockets."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.basler_stereo import BaslerStereoPair
from drivers.basler_stereo.errors import (
    CablesSwapped,
    CameraLost,
    ControlLost,
    ControlTaken,
    NoCamera,
    OutOfRange,
    PacketTooLarge,
    ReceptionEnded,
    TriggerMissed,
    WrongModel,
    WrongSerial,
)
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle, StereoPair
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.readings import AreaOfInterest, Validity

PEER = Path(__file__).with_name("basler_peer_camera.py")
SERIALS = ("21900001", "21900002")
FULL = AreaOfInterest(0, 0, 256, 128)
_numbers = itertools.count(1)


def free_address() -> str:
    """A loopback address on which nobody has a camera's port."""
    while True:
        address = f"127.66.{os.getpid() % 250 + 1}.{next(_numbers) % 250 + 1}"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((address, 3956))
            except OSError:
                continue
            return address


class Peer:
    def __init__(self, serial: str, *options: str) -> None:
        self.address = free_address()
        self.serial = serial
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PEER), self.address, serial, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ready(self) -> Peer:
        assert self._process.stdout.readline() == "READY\n"
        return self

    def fault(self, *words: object) -> str:
        self._process.stdin.write(" ".join(str(word) for word in words) + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        self._process.stdout.close()


@pytest.fixture
def make_peer():
    made = []

    def make(*arguments: str) -> Peer:
        made.append(Peer(*arguments))
        return made[-1]

    yield make
    for peer in made:
        peer.close()


@pytest.fixture
def peers(make_peer):
    started = [make_peer(serial) for serial in SERIALS]
    return [peer.ready() for peer in started]


@pytest.fixture
def make_pair(peers):
    made = []

    def make(left=None, right=None, **options) -> BaslerStereoPair:
        left, right = left or peers[0], right or peers[1]
        config = DeviceConfig(
            driver="basler_stereo",
            endpoints={"left": f"gev://{left.address}", "right": f"gev://{right.address}"},
            options={"left_serial": SERIALS[0], "right_serial": SERIALS[1], **options},
        )
        made.append(BaslerStereoPair("stereo", config, HostClock()))
        return made[-1]

    yield make
    for device in made:
        device.close()


@pytest.fixture
def pair(make_pair):
    device = make_pair(heartbeat_ms=1000)
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    return device


def pattern(area: AreaOfInterest, block_id: int) -> np.ndarray:
    rows, columns = np.mgrid[: area.height, : area.width]
    return (columns + area.offset_x) + 3 * (rows + area.offset_y) + 7 * block_id


def wait_until(condition, limit_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s, "the awaited condition did not come"
        time.sleep(0.01)


def test_the_driver_is_a_stereo_pair(make_pair):
    assert isinstance(make_pair(), StereoPair)


def test_identity_serials_and_states_follow_the_lifecycle(make_pair):
    device = make_pair()
    assert device.state is Lifecycle.DISCONNECTED
    identity = device.connect(5.0)
    assert (identity.vendor, identity.model) == ("Basler", "acA2000-50gmNIR")
    assert identity.serial == "+".join(SERIALS)
    assert device.serials == SERIALS
    device.configure(5.0)
    assert device.areas == (FULL, FULL)
    device.activate(5.0)
    assert device.state is Lifecycle.ACTIVE
    device.deactivate(5.0)
    assert device.state is Lifecycle.CONFIGURED
    device.close()
    assert device.state is Lifecycle.CLOSED


def test_every_trigger_gives_one_complete_pair_with_the_pixels_that_were_sent(pair, peers):
    for block_id in (1, 2, 3):
        reading = pair.grab_pair(2.0)
        assert reading.validity is Validity.OK
        assert reading.stamp.sequence == block_id
        for image, serial in ((reading.left, SERIALS[0]), (reading.right, SERIALS[1])):
            assert image.serial == serial
            assert image.area == FULL
            assert np.array_equal(image.pixels, pattern(FULL, block_id) & 0xFF)
            assert not image.pixels.flags.writeable
    assert [peer.fault("count") for peer in peers] == ["3 DONE\n", "3 DONE\n"]


def test_device_clock_and_theatre_time_go_forward(pair):
    first, second = pair.grab_pair(2.0), pair.grab_pair(2.0)
    for before, after in ((first.left, second.left), (first.right, second.right), (first, second)):
        assert after.stamp.device_clock > before.stamp.device_clock
        assert after.stamp.theatre_time_s > before.stamp.theatre_time_s


@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono12Packed"])
def test_twelve_bits_arrive_as_twelve_bits(make_pair, pixel_format):
    device = make_pair(pixel_format=pixel_format)
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    reading = device.grab_pair(2.0)
    assert reading.left.pixels.dtype == np.uint16
    assert np.array_equal(reading.left.pixels, 16 * pattern(FULL, 1) & 0xFFF)


def test_areas_are_read_where_they_were_set_and_the_stream_goes_on(pair):
    left, right = AreaOfInterest(32, 8, 64, 48), AreaOfInterest(160, 100, 96, 28)
    pair.set_areas(left, right)
    reading = pair.grab_pair(2.0)
    assert (reading.left.area, reading.right.area) == (left, right)
    assert np.array_equal(reading.left.pixels, pattern(left, 1) & 0xFF)
    assert np.array_equal(reading.right.pixels, pattern(right, 1) & 0xFF)


@pytest.mark.parametrize(
    "area",
    [
        AreaOfInterest(0, 0, 272, 128),
        AreaOfInterest(200, 0, 64, 64),
        AreaOfInterest(8, 0, 64, 64),
        AreaOfInterest(0, 0, 40, 64),
        AreaOfInterest(0, -1, 64, 64),
        AreaOfInterest(0, 0, 0, 64),
    ],
)
def test_an_impossible_area_is_refused_and_the_old_one_stays(pair, area):
    with pytest.raises(OutOfRange, match="GEV-011"):
        pair.set_areas(AreaOfInterest(0, 0, 64, 64), area)
    assert pair.areas == (FULL, FULL)
    assert pair.grab_pair(2.0).validity is Validity.OK


@pytest.mark.parametrize(("exposure_us", "gain_raw"), [(10.0, 40), (2e6, 40), (500.0, 10), (500.0, 600)])
def test_exposure_and_gain_outside_the_cameras_limits_are_refused(pair, exposure_us, gain_raw):
    with pytest.raises(OutOfRange, match="GEV-011"):
        pair.set_exposure(exposure_us, gain_raw)
    assert pair.state is Lifecycle.ACTIVE


def test_exposure_is_set_while_streaming(pair):
    pair.set_exposure(750.0, 100)
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_lost_packets_are_asked_for_again(make_pair, peers):
    device = make_pair(packet_bytes=576)
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    peers[0].fault("drop", 0, 5, 6, 40, 62)  # the leader and the trailer are 0 and 62
    reading = device.grab_pair(2.0)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, pattern(FULL, 1) & 0xFF)
    assert device.counters[0].resend_requests >= 4  # a busy computer asks more often


@pytest.mark.hazard(25)
def test_packets_that_are_gone_make_a_partial_reading(make_pair, peers):
    device = make_pair(packet_bytes=576)
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    peers[1].fault("refuse-resend")
    peers[1].fault("drop", 3, 4)
    reading = device.grab_pair(2.0)
    assert reading.validity is Validity.PARTIAL
    assert reading.left.validity is Validity.OK
    assert (reading.right.validity, reading.right.missing_packets) == (Validity.PARTIAL, 2)
    peers[1].fault("normal")
    assert device.grab_pair(2.0).validity is Validity.OK


@pytest.mark.hazard(25)
def test_a_leader_that_tells_of_another_area_makes_a_corrupt_reading(pair, peers):
    peers[0].fault("wrong-area")
    reading = pair.grab_pair(2.0)
    assert reading.validity is Validity.CORRUPT
    assert reading.right.validity is Validity.OK


@pytest.mark.hazard(25)
def test_a_side_that_sends_no_image_is_missing_and_the_next_pair_is_in_step(pair, peers):
    peers[0].fault("no-frames")
    reading = pair.grab_pair(0.3)
    assert reading.validity is Validity.MISSING
    assert reading.left is None
    assert reading.right.validity is Validity.OK
    peers[0].fault("normal")
    reading = pair.grab_pair(2.0)
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
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_a_stream_that_stops_in_the_middle_is_given_up_within_the_limit(pair, peers):
    peers[0].fault("mute-stream")
    peers[0].fault("refuse-resend")
    start_s = time.monotonic()
    reading = pair.grab_pair(1.5)
    assert reading.validity in (Validity.PARTIAL, Validity.MISSING)
    assert time.monotonic() - start_s < 2.5


@pytest.mark.hazard(4)
def test_a_dead_camera_latches_a_fault_and_recover_brings_it_back(pair, peers, make_pair):
    peers[1].fault("mute")
    with pytest.raises(CameraLost, match="GEV-014"):
        pair.grab_pair(1.0)
    assert pair.state is Lifecycle.FAULT
    with pytest.raises(WrongState, match="GEV-014"):
        pair.grab_pair(1.0)
    # it hears again, but its heartbeat has run out and the settings with it
    peers[1].fault("normal")
    pair.recover("a tester", 5.0)
    assert pair.state is Lifecycle.CONFIGURED
    pair.activate(5.0)
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_the_heartbeat_keeps_control_while_nothing_is_asked(pair, peers):
    time.sleep(1.5)  # the time-out is 1 s
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_a_camera_that_lets_go_is_noticed_by_the_heartbeat(pair, peers):
    peers[0].fault("let-go")
    wait_until(lambda: any(camera.lost for camera in pair._pair))
    with pytest.raises(ControlLost, match="GEV-015"):
        pair.grab_pair(1.0)
    assert pair.state is Lifecycle.FAULT


def test_a_refused_trigger_means_that_control_is_lost(pair, peers):
    peers[1].fault("taken")
    with pytest.raises(ControlLost, match="GEV-015"):
        pair.grab_pair(1.0)
    peers[1].fault("normal")


def test_a_recovery_needs_a_name(pair, peers):
    peers[0].fault("let-go")
    wait_until(lambda: any(camera.lost for camera in pair._pair))
    with pytest.raises(ControlLost):
        pair.grab_pair(1.0)
    with pytest.raises(ValueError, match="name"):
        pair.recover("  ")


def test_nobody_at_the_address(make_pair, peers):
    class Nobody:
        address = free_address()

    device = make_pair(left=Nobody())
    with pytest.raises(NoCamera, match="GEV-001"):
        device.connect(1.0)
    assert device.state is Lifecycle.DISCONNECTED


def test_another_model_is_refused(make_pair, make_peer):
    other = make_peer(SERIALS[0], "--model", "acA640-120gm").ready()
    with pytest.raises(WrongModel, match=r"GEV-002.*acA640-120gm"):
        make_pair(left=other).connect(2.0)


@pytest.mark.hazard(25)
def test_swapped_cables_are_told_from_a_wrong_camera(make_pair, peers):
    with pytest.raises(CablesSwapped, match="GEV-004"):
        make_pair(left=peers[1], right=peers[0]).connect(2.0)
    with pytest.raises(WrongSerial, match="GEV-003"):
        make_pair(right_serial="21900009").connect(2.0)
    with pytest.raises(WrongSerial, match="GEV-003"):
        make_pair(left=peers[0], right=peers[0]).connect(2.0)


@pytest.mark.hazard(34)
def test_a_second_controller_is_refused_and_the_first_goes_on(pair, make_pair):
    second = make_pair()
    second.connect(2.0)
    with pytest.raises(ControlTaken, match="GEV-005"):
        second.configure(2.0)
    assert second.state is Lifecycle.CONNECTED
    assert pair.grab_pair(2.0).validity is Validity.OK


def test_after_a_failed_configure_neither_camera_is_controlled(make_pair, peers):
    peers[1].fault("taken")
    device = make_pair()
    device.connect(2.0)
    with pytest.raises(ControlTaken):
        device.configure(2.0)
    peers[1].fault("normal")
    device.configure(5.0)
    assert device.state is Lifecycle.CONFIGURED


def test_a_packet_size_that_does_not_arrive_is_refused(make_pair, make_peer):
    narrow = make_peer(SERIALS[0], "--largest-packet", "1500").ready()
    device = make_pair(left=narrow, packet_bytes=8000)
    device.connect(2.0)
    with pytest.raises(PacketTooLarge, match="GEV-012"):
        device.configure(5.0)


def test_without_a_wish_the_largest_packets_that_arrive_are_used(make_pair, make_peer):
    narrow = make_peer(SERIALS[0], "--largest-packet", "1500").ready()
    device = make_pair(left=narrow)
    device.connect(2.0)
    device.configure(5.0)
    device.activate(2.0)
    device.grab_pair(2.0)
    # 32768 bytes in packets of 1464 and 8156 bytes of data, with leader and trailer
    assert [counters.packets for counters in device.counters] == [23 + 2, 5 + 2]
    assert device.notices == ()


def test_a_camera_without_test_packets_is_believed(make_pair, make_peer):
    silent = make_peer(SERIALS[0], "--largest-packet", "0").ready()
    device = make_pair(left=silent)
    device.connect(2.0)
    device.configure(5.0)
    assert any("no test packets" in notice for notice in device.notices)


def test_an_answer_that_is_announced_as_late_is_waited_for(pair, peers):
    peers[0].fault("pending", 400)
    reading = pair.grab_pair(5.0)
    assert reading.validity is Validity.OK
    assert peers[0].fault("count") == "1 DONE\n"
    peers[0].fault("normal")


def test_close_is_bounded_with_dead_cameras(pair, peers):
    for peer in peers:
        peer.kill()
    start_s = time.monotonic()
    pair.close()
    assert time.monotonic() - start_s < 4.0
    assert pair.state is Lifecycle.CLOSED


def test_close_is_bounded_with_cameras_that_hear_but_do_not_answer(pair, peers):
    for peer in peers:
        peer.fault("mute")
    start_s = time.monotonic()
    pair.close()
    assert time.monotonic() - start_s < 6.0


def test_close_gives_control_back_and_leaves_no_thread_and_no_process(pair, make_pair):
    before = threading.active_count()
    reception = pair._reception.pid
    pair.close()
    assert threading.active_count() <= before - 2
    assert not Path(f"/proc/{reception}").exists()
    second = make_pair()
    second.connect(2.0)
    second.configure(5.0)
    assert second.state is Lifecycle.CONFIGURED


def test_grabbing_is_refused_before_activate(make_pair):
    device = make_pair()
    with pytest.raises(WrongState, match="DEV-001"):
        device.grab_pair()
    with pytest.raises(WrongState, match="DEV-001"):
        _ = device.areas
    assert device.serials == ("", "")


@pytest.mark.hazard(4)
def test_the_end_of_our_own_reception_is_a_fault_and_recover_starts_it_anew(pair):
    os.kill(pair._reception.pid, signal.SIGKILL)
    with pytest.raises(ReceptionEnded, match="GEV-017"):
        pair.grab_pair(5.0)
    assert pair.state is Lifecycle.FAULT
    pair.recover("a tester", 5.0)
    pair.activate(5.0)
    assert pair.grab_pair(5.0).validity is Validity.OK


def test_images_and_control_survive_a_driver_that_computes_without_pause(make_pair, peers):
    device = make_pair(heartbeat_ms=500)
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    for _ in range(3):
        # one operation that never lets another thread of this process run, longer than the time-out
        began_s = time.monotonic()
        number = 3
        while time.monotonic() - began_s < 0.7:
            number = pow(3, number % 1000 + 60_000)
        assert device.grab_pair(5.0).validity is Validity.OK
    assert device.counters[0].incomplete_frames == 0


def test_an_image_of_which_every_packet_was_lost_is_asked_for(make_pair, peers):
    device = make_pair()
    device.connect(5.0)
    device.configure(5.0)
    device.activate(5.0)
    peers[0].fault("drop", *range(7))  # leader, five payload packets, trailer
    reading = device.grab_pair(5.0)
    assert reading.validity is Validity.OK
    assert np.array_equal(reading.left.pixels, pattern(FULL, 1) & 0xFF)


def test_a_trigger_without_any_image_is_repeated_once(pair, peers):
    for peer in peers:
        peer.fault("no-frames")

    def speak_again() -> None:
        for peer in peers:
            peer.fault("normal")

    timer = threading.Timer(1.0, speak_again)
    timer.start()
    reading = pair.grab_pair(4.0)
    timer.join()
    assert reading.validity is Validity.OK
    assert [peer.fault("count") for peer in peers] == ["2 DONE\n", "2 DONE\n"]
