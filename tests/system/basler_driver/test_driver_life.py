"""The stereo driver's life, from the first question to the last: states, control, processes."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
from peer_cameras import FULL, HANG_LIMIT_S, SERIALS

from ronna_hw.devices import LastKnown, Lifecycle, StereoPair
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.readings import Validity


def test_the_driver_is_a_stereo_pair(make_pair):
    assert isinstance(make_pair(), StereoPair)


def test_identity_serials_and_states_follow_the_lifecycle(make_pair):
    device = make_pair()
    assert device.state is Lifecycle.DISCONNECTED
    identity = device.connect(HANG_LIMIT_S)
    assert (identity.vendor, identity.model) == ("Basler", "acA2000-50gmNIR")
    assert identity.serial == "+".join(SERIALS)
    assert device.serials == SERIALS
    device.configure(HANG_LIMIT_S)
    assert device.areas == (FULL, FULL)
    device.activate(HANG_LIMIT_S)
    assert device.state is Lifecycle.ACTIVE
    device.deactivate(5.0)
    assert device.state is Lifecycle.CONFIGURED
    device.close()
    assert device.state is Lifecycle.CLOSED


def test_the_pair_can_be_observed_in_every_state(make_pair):
    device = make_pair()
    assert device.observe() == LastKnown(Lifecycle.DISCONNECTED, None, None)
    with device.active(HANG_LIMIT_S):
        reading = device.grab_pair(HANG_LIMIT_S)
        assert device.observe().state is Lifecycle.ACTIVE
        assert device.observe().reading is reading
    device.close()
    assert device.observe().state is Lifecycle.CLOSED
    assert device.observe().reading is reading


def test_grabbing_is_refused_before_activate(make_pair):
    device = make_pair()
    with pytest.raises(WrongState, match="DEV-001"):
        device.grab_pair()
    with pytest.raises(WrongState, match="DEV-001"):
        _ = device.areas
    assert device.serials == ("", "")


def test_the_heartbeat_keeps_control_while_nothing_is_asked(pair, peers):
    time.sleep(1.5)  # the time-out is 1 s
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK


def test_images_and_control_survive_a_driver_that_computes_without_pause(make_pair, peers):
    device = make_pair(heartbeat_ms=500)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    for _ in range(3):
        # one operation that never lets another thread of this process run, longer than the time-out
        began_s = time.monotonic()
        number = 3
        while time.monotonic() - began_s < 0.7:
            number = pow(3, number % 1000 + 60_000)
        assert device.grab_pair(HANG_LIMIT_S).validity is Validity.OK
    assert device.counters[0].incomplete_frames == 0


def test_an_answer_that_is_announced_as_late_is_waited_for(pair, peers):
    peers[0].fault("pending", 400)
    reading = pair.grab_pair(HANG_LIMIT_S)
    assert reading.validity is Validity.OK
    assert peers[0].fault("count") == "1 DONE\n"
    peers[0].fault("normal")


def test_close_is_bounded_with_dead_cameras(pair, peers):
    for peer in peers:
        peer.kill()
    start_s = time.monotonic()
    pair.close()
    assert time.monotonic() - start_s < HANG_LIMIT_S
    assert pair.state is Lifecycle.CLOSED


def test_close_is_bounded_with_cameras_that_hear_but_do_not_answer(pair, peers):
    for peer in peers:
        peer.fault("mute")
    start_s = time.monotonic()
    pair.close()
    assert time.monotonic() - start_s < HANG_LIMIT_S


def test_close_gives_control_back_and_leaves_no_thread_and_no_process(pair, make_pair):
    before = threading.active_count()
    receiver = pair._receiver_process.pid
    pair.close()
    assert threading.active_count() <= before - 2
    assert not Path(f"/proc/{receiver}").exists()
    second = make_pair()
    second.connect(HANG_LIMIT_S)
    second.configure(HANG_LIMIT_S)
    assert second.state is Lifecycle.CONFIGURED
