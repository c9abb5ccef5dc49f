"""The stereo driver's lifecycle on running cameras: what it accepts and refuses, faults, and closing."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from coded_errors import raises
from faulty_cameras import LIMIT_S, Cameras

from drivers.basler_stereo import BaslerStereoPair
from drivers.basler_stereo.errors import (
    WRONG_SERIAL,
    CameraLost,
    CommandRefused,
    ControlTaken,
    NoReply,
    ReceiverEnded,
)
from ronna_hw.devices import LastKnown, Lifecycle
from ronna_hw.devices.errors import DEVICE_STREAMS, PersonNotNamed, WrongState
from ronna_hw.devices.readings import AreaOfInterest, Validity

SERIALS = ("21904411", "21904412")
FULL = AreaOfInterest(0, 0, 2048, 1088)


def test_identity_states_and_observation_follow_the_lifecycle(cameras: Cameras) -> None:
    pair = cameras.new_pair(left_serial=SERIALS[0], right_serial=SERIALS[1])
    assert pair.observe() == LastKnown(Lifecycle.DISCONNECTED, None, None)
    assert pair.serials == ("", "")
    with pytest.raises(WrongState, match="DEV-001"):
        pair.grab_pair()
    with pytest.raises(WrongState, match="DEV-001"):
        _ = pair.areas
    identity = pair.connect(LIMIT_S)
    assert (identity.vendor, identity.model) == ("Basler", "acA2000-50gmNIR")
    assert (identity.serial, pair.serials) == ("+".join(SERIALS), SERIALS)
    pair.configure(LIMIT_S)
    assert pair.areas == (FULL, FULL)
    assert pair.notices == ()
    with pair.active(LIMIT_S):
        reading = pair.grab_pair(LIMIT_S)
        assert pair.observe().state is Lifecycle.ACTIVE
    assert pair.state is Lifecycle.CONFIGURED
    pair.close()
    assert pair.observe().state is Lifecycle.CLOSED
    assert pair.observe().reading is reading


def test_a_stream_has_the_cameras_until_it_is_left_or_they_are_deactivated(cameras: Cameras) -> None:
    pair = cameras.new_pair()
    with pair.active(LIMIT_S):
        readings = iter(pair.stream())
        next(readings)
        for call in (pair.grab_pair, lambda: pair.scale_exposure(0.5), pair.readiness):
            with raises(DEVICE_STREAMS):
                call()
        pair.deactivate(LIMIT_S)
        assert list(readings) == []
        assert (pair.state, pair.fault) == (Lifecycle.CONFIGURED, None)
    pair.close()


def test_after_a_failed_configure_neither_camera_is_controlled(cameras: Cameras) -> None:
    cameras.fault("seize right")
    refused = cameras.new_pair()
    refused.connect(LIMIT_S)
    with pytest.raises(ControlTaken):
        refused.configure(1.0)
    cameras.heal()
    assert cameras.streaming().grab_pair(LIMIT_S).validity is Validity.OK


def test_a_camera_without_test_packets_is_accepted_with_a_notice(cameras: Cameras) -> None:
    cameras.fault("narrow path left 100 bytes")
    pair = cameras.new_pair()
    pair.connect(LIMIT_S)
    pair.configure(LIMIT_S)
    assert [notice.split(":")[0] for notice in pair.notices if "no test packets" in notice] == ["left"]


def test_images_and_control_survive_a_driver_process_that_computes_without_pause(cameras: Cameras) -> None:
    pair = cameras.streaming(heartbeat_ms=500)
    for _ in range(2):
        # one operation that never lets another thread of this process run, longer than the time-out
        began_s, number = time.monotonic(), 3
        while time.monotonic() - began_s < 0.7:
            number = pow(3, number % 1000 + 60_000)
        assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert pair.counters[0].incomplete_frames == 0


def test_a_silent_camera_is_a_fault_during_a_setting_but_not_during_a_grab_before_its_time_out(
    cameras: Cameras,
) -> None:
    pair = cameras.streaming(heartbeat_ms=60_000)
    cameras.fault("unplug right")
    with pytest.raises(NoReply, match=f"GEV-007: {cameras.addresses[1]}"):
        pair.grab_pair(0.5)
    assert pair.state is Lifecycle.ACTIVE
    cameras.heal()
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    cameras.fault("unplug right")
    with pytest.raises(CameraLost, match=f"GEV-014.*{cameras.addresses[1]}: no reply"):
        pair.set_exposure(500.0, 40, 0.5)  # whether it was taken is unknown
    assert pair.state is Lifecycle.FAULT


def test_a_grab_restarts_the_streams_after_a_camera_has_refused_to_stop(
    cameras: Cameras, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = cameras.streaming()

    def refuse(name: str) -> None:
        raise CommandRefused(f"{name} was rejected")

    with monkeypatch.context() as refusing:
        refusing.setattr(pair._pair[0].features, "execute", refuse)
        with pytest.raises(CommandRefused, match="GEV-006: AcquisitionStop"):
            pair.deactivate(LIMIT_S)
    assert pair.state is Lifecycle.ACTIVE
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    pair.deactivate(LIMIT_S)


@pytest.mark.hazard(4)
def test_a_killed_receiver_process_is_a_fault_and_recovery_requires_a_named_person(cameras: Cameras) -> None:
    pair = cameras.streaming()
    assert pair._receiver_process is not None
    os.kill(pair._receiver_process.pid, signal.SIGKILL)
    with pytest.raises(ReceiverEnded, match="GEV-017"):
        pair.grab_pair(LIMIT_S)
    assert pair.state is Lifecycle.FAULT
    with pytest.raises(WrongState, match="GEV-017"):
        pair.grab_pair(1.0)
    with pytest.raises(PersonNotNamed, match="DEV-006"):
        pair.recover("  ")
    pair.recover("a tester", LIMIT_S)
    pair.activate(LIMIT_S)
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK


def test_recovery_is_refused_with_other_cameras_at_the_addresses_and_the_fault_stays(
    cameras: Cameras, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = cameras.streaming()
    cameras.fault("unplug right")
    with pytest.raises(CameraLost):
        pair.set_exposure(500.0, 40, 0.5)
    cameras.heal()
    left, right = cameras.addresses
    with monkeypatch.context() as changed:
        changed.setattr(pair, "_addresses", {"left": right, "right": left})
        with raises(WRONG_SERIAL, match="GEV-003: different cameras than before"):
            pair.recover("a tester", LIMIT_S)
    assert pair.state is Lifecycle.FAULT
    pair.recover("a tester", LIMIT_S)
    assert pair.state is Lifecycle.CONFIGURED


def test_close_releases_control_and_leaves_no_thread_and_no_process(cameras: Cameras) -> None:
    pair = cameras.streaming()
    before = threading.active_count()
    assert pair._receiver_process is not None
    receiver = pair._receiver_process.pid
    pair.close()
    assert threading.active_count() <= before - 2
    assert not Path(f"/proc/{receiver}").exists()
    assert cameras.streaming().state is Lifecycle.ACTIVE


def closed_within_limit(pair: BaslerStereoPair) -> bool:
    began_s = time.monotonic()
    pair.close()
    return pair.state is Lifecycle.CLOSED and time.monotonic() - began_s < LIMIT_S


def test_close_is_bounded_with_cameras_that_do_not_reply(cameras: Cameras) -> None:
    pair = cameras.streaming()
    cameras.fault("unplug both")
    assert closed_within_limit(pair)
