"""Every fault of the cameras, switched on in simulators that run, and what a client sees of it."""

from __future__ import annotations

import json
import socket
import threading
import time

import numpy as np
import pytest

from drivers.basler_stereo import BaslerStereoPair
from drivers.basler_stereo.errors import (
    CameraLost,
    ControlLost,
    ControlTaken,
    NoCamera,
    PacketTooLarge,
    TriggerMissed,
)
from ronna_hw.child_process import ChildProcess, command
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, Validity
from ronna_hw.endpoints import parse_endpoint

AREA = AreaOfInterest(896, 416, 256, 256)
FAST = 10.0


class Cameras:
    """The simulated cameras, and pairs that are connected to them."""

    def __init__(self, child: ChildProcess) -> None:
        self._endpoints = dict(child.ready["endpoints"])
        self._control = parse_endpoint(child.ready["control"]).require("tcp")
        self._pairs: list[BaslerStereoPair] = []

    def tell(self, **request: str) -> None:
        with socket.create_connection((self._control.host, self._control.port), FAST) as door:
            door.sendall(json.dumps(request).encode() + b"\n")
            answer = json.loads(door.makefile("rb").readline())
        assert answer["ok"], answer

    def fault(self, phrase: str) -> None:
        self.tell(do="fault", line=f"now: camera {phrase}")

    def heal(self) -> None:
        self.tell(do="clear_faults")

    def new_pair(self, **options: object) -> BaslerStereoPair:
        config = DeviceConfig(driver="basler_stereo", endpoints=self._endpoints, options=options)
        self._pairs.append(BaslerStereoPair("stereo", config, HostClock()))
        return self._pairs[-1]

    def streaming(self, **options: object) -> BaslerStereoPair:
        pair = self.new_pair(**options)
        pair.connect(FAST)
        pair.configure(FAST)
        pair.set_areas(AREA, AREA)
        pair.activate(FAST)
        return pair

    def close(self) -> None:
        self.heal()
        for pair in self._pairs:
            pair.close()
        self._pairs.clear()


@pytest.fixture(scope="module")
def running():
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as child:
        yield Cameras(child)


@pytest.fixture
def cameras(running):
    yield running
    running.close()


def grab_on(pair: BaslerStereoPair) -> None:
    deadline_s = time.monotonic() + 30.0
    while time.monotonic() < deadline_s:
        pair.grab_pair(1.0)


@pytest.mark.parametrize(
    "phrase", ["lose left 10 %", "omit leader left", "omit trailer left", "omit frames left"]
)
def test_lost_packets_are_repeated(cameras, phrase):
    pair = cameras.streaming(packet_bytes=1500)
    cameras.fault(phrase)
    assert pair.grab_pair(FAST).validity is Validity.OK
    assert pair.counters[0].resend_requests > 0


@pytest.mark.parametrize("phrase", ["shuffle both", "duplicate both 50 %"])
def test_disorder_and_repetition_change_nothing(cameras, phrase):
    pair = cameras.streaming(packet_bytes=1500)
    plain = pair.grab_pair(FAST).left.pixels
    cameras.fault(phrase)
    reading = pair.grab_pair(FAST)
    assert reading.validity is Validity.OK
    assert abs(float(reading.left.pixels.mean()) - float(plain.mean())) < 2.0
    if phrase.startswith("duplicate"):
        assert pair.counters[0].duplicates > 0


def test_packets_that_are_forgotten_leave_a_partial_image(cameras):
    pair = cameras.streaming(packet_bytes=1500)
    cameras.fault("lose right 10 %")
    cameras.fault("forget right")
    reading = pair.grab_pair(FAST)
    assert reading.validity is Validity.PARTIAL
    assert (reading.left.validity, reading.right.validity) == (Validity.OK, Validity.PARTIAL)
    assert reading.right.missing_packets > 0


def test_a_frame_that_is_lost_for_good_leaves_its_partner_alone(cameras):
    pair = cameras.streaming()
    cameras.fault("omit frames left")
    cameras.fault("forget left")
    reading = pair.grab_pair(1.0)
    assert (reading.validity, reading.left) == (Validity.MISSING, None)
    assert reading.right.validity is Validity.OK
    cameras.heal()
    assert pair.grab_pair(FAST).validity is Validity.OK


def test_a_leader_that_tells_of_another_area_makes_the_image_corrupt(cameras):
    pair = cameras.streaming()
    cameras.fault("shift area left")
    reading = pair.grab_pair(FAST)
    assert (reading.validity, reading.left.validity) == (Validity.CORRUPT, Validity.CORRUPT)


def test_images_with_half_of_their_data_are_no_complete_pair(cameras):
    pair = cameras.streaming()
    cameras.fault("truncate left")
    assert pair.grab_pair(FAST).validity in (Validity.PARTIAL, Validity.MISSING)


@pytest.mark.hazard(25)
def test_one_camera_that_misses_a_trigger_leaves_the_other_unpaired(cameras):
    pair = cameras.streaming()
    cameras.fault("miss triggers right")
    reading = pair.grab_pair(1.0)
    assert (reading.validity, reading.right) == (Validity.MISSING, None)
    cameras.heal()
    assert pair.grab_pair(FAST).validity is Validity.OK
    assert pair.block_ids == (1, 1)


def test_a_trigger_that_reaches_nobody_is_told(cameras):
    pair = cameras.streaming()
    cameras.fault("miss triggers both")
    with pytest.raises(TriggerMissed, match="GEV-013"):
        pair.grab_pair(0.5)
    assert pair.state is Lifecycle.ACTIVE


@pytest.mark.hazard(25)
def test_a_pair_that_is_out_of_step_is_flagged_and_comes_back_into_step(cameras):
    pair = cameras.streaming()
    assert pair.grab_pair(FAST).validity is Validity.OK
    cameras.fault("expose late right 300 ms")
    assert pair.grab_pair(FAST).validity is Validity.UNPAIRED
    cameras.heal()
    assert pair.grab_pair(FAST).validity is Validity.OK


def test_a_clock_that_begins_anew_is_noticed_and_tied_anew(cameras):
    pair = cameras.streaming()
    for _ in range(2):
        assert pair.grab_pair(FAST).validity is Validity.OK
    assert pair.block_ids == (2, 2)
    cameras.fault("reset clock left")
    assert pair.grab_pair(0.9).validity is Validity.UNPAIRED  # too little time for a second trigger
    assert pair.grab_pair(FAST).validity is Validity.OK
    assert pair.block_ids == (1, 1)  # the streams were begun anew


def test_a_clock_that_drifts_as_cameras_do_keeps_the_pair_and_a_wild_one_does_not(cameras):
    pair = cameras.streaming()
    cameras.fault("drift left +100 ppm")
    assert all(pair.grab_pair(FAST).validity is Validity.OK for _ in range(3))
    cameras.heal()
    cameras.fault("drift left +900000 ppm")
    time.sleep(0.2)  # what has to pass is time
    assert pair.grab_pair(0.9).validity is Validity.UNPAIRED


@pytest.mark.hazard(4)
def test_a_camera_off_the_network_is_lost_and_recovered(cameras):
    pair = cameras.streaming()
    cameras.fault("unplug right")
    with pytest.raises(CameraLost, match="GEV-014"):
        pair.grab_pair(FAST)
    assert pair.state is Lifecycle.FAULT
    cameras.heal()
    pair.recover("a tester", FAST)
    pair.activate(FAST)
    assert pair.grab_pair(FAST).validity is Validity.OK


def test_two_cameras_off_the_network_are_not_found(cameras):
    cameras.fault("unplug both")
    with pytest.raises(NoCamera, match="GEV-001"):
        cameras.new_pair().connect(1.0)


@pytest.mark.parametrize("phrase", ["restart left", "seize left"])
def test_a_camera_that_is_no_longer_ours_is_told(cameras, phrase):
    pair = cameras.streaming()
    cameras.fault(phrase)
    with pytest.raises(ControlLost, match="GEV-015"):
        grab_on(pair)
    assert pair.state is Lifecycle.FAULT


def test_heartbeats_that_do_not_count_end_control(cameras):
    pair = cameras.streaming(heartbeat_ms=500)
    cameras.fault("ignore heartbeat left")
    with pytest.raises(ControlLost, match="GEV-015"):
        grab_on(pair)


def test_another_controller_is_told(cameras):
    cameras.fault("seize right")
    pair = cameras.new_pair()
    pair.connect(FAST)
    with pytest.raises(ControlTaken, match="GEV-005"):
        pair.configure(1.0)


@pytest.mark.parametrize(
    "phrase", ["delay answers both 300 ms", "announce answers both 300 ms", "lose answers both 30 %"]
)
def test_answers_that_are_late_or_lost_delay_and_no_trigger_acts_twice(cameras, phrase):
    pair = cameras.streaming(pair_skew_ms=1000.0)
    cameras.fault(phrase)
    assert pair.grab_pair(FAST).validity is Validity.OK
    cameras.heal()
    assert pair.grab_pair(FAST).validity is Validity.OK
    assert pair.block_ids == (2, 2)


def test_the_packet_size_is_what_the_path_carries(cameras):
    cameras.fault("narrow path both 2000 bytes")
    wide = cameras.new_pair(packet_bytes=8000)
    wide.connect(FAST)
    with pytest.raises(PacketTooLarge, match="GEV-012"):
        wide.configure(FAST)
    wide.close()
    pair = cameras.streaming()
    assert pair.grab_pair(FAST).validity is Validity.OK
    packets = -(-AREA.width * AREA.height // (1500 - 36)) + 2
    assert [counters.packets for counters in pair.counters] == [packets, packets]


def test_spoiled_light_is_seen(cameras):
    pair = cameras.streaming()
    plain = pair.grab_pair(FAST).left.pixels.astype(float)
    seen = {}
    for phrase in ("saturate left", "darken left", "defocus left 20 px", "dust left 500 spots"):
        cameras.fault(phrase)
        seen[phrase.split()[0]] = pair.grab_pair(FAST).left.pixels.astype(float)
        cameras.heal()
    assert seen["saturate"].min() == 255.0
    assert seen["darken"].max() < 30.0
    assert np.abs(np.diff(seen["defocus"])).max() < np.abs(np.diff(plain)).max()
    assert (seen["dust"] < 0.5 * plain).sum() > (seen["defocus"] < 0.1 * plain).sum()


def test_one_action_gives_one_pair(cameras):
    pair = cameras.streaming(trigger="action", pair_skew_ms=1000.0)  # a busy computer is not the matter here
    for number in (1, 2):
        assert pair.grab_pair(FAST).validity is Validity.OK
        assert pair.block_ids == (number, number)


def test_one_pulse_on_the_line_gives_one_pair(cameras):
    pair = cameras.streaming(trigger="line1", pair_skew_ms=1000.0)
    with pytest.raises(TriggerMissed, match="GEV-013"):
        pair.grab_pair(0.2)  # nobody pulses
    for number in (1, 2):
        pulse = threading.Timer(0.3, cameras.fault, ["pulse line"])
        pulse.start()
        assert pair.grab_pair(FAST).validity is Validity.OK
        assert pair.block_ids == (number, number)
        pulse.join()
