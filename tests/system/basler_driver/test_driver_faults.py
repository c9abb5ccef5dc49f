"""What latches a fault in the stereo driver, and how it is left."""

from __future__ import annotations

import os
import signal

import pytest
from peer_cameras import HANG_LIMIT_S
from waiting import eventually

from drivers.basler_stereo.errors import CameraLost, ControlLost, NoReply, ReceiverEnded
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.errors import PersonNotNamed, WrongState
from ronna_hw.devices.readings import Validity


@pytest.mark.hazard(4)
def test_a_dead_camera_latches_a_fault_and_recover_brings_it_back(pair, peers, make_pair):
    peers[1].fault("mute")
    with pytest.raises(CameraLost, match=rf"GEV-014: {peers[1].address}.*limit 1 s"):
        pair.grab_pair(HANG_LIMIT_S)
    assert pair.state is Lifecycle.FAULT
    with pytest.raises(WrongState, match="GEV-014"):
        pair.grab_pair(1.0)
    # it hears again, but its heartbeat has run out and the settings with it
    peers[1].fault("normal")
    pair.recover("a tester", HANG_LIMIT_S)
    assert pair.state is Lifecycle.CONFIGURED
    pair.activate(HANG_LIMIT_S)
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK


def test_a_camera_that_is_silent_is_no_fault_before_its_heartbeat_time_out(make_pair, peers):
    device = make_pair(heartbeat_ms=60_000)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    peers[1].fault("mute")
    with pytest.raises(NoReply, match=f"GEV-007: {peers[1].address}"):
        device.grab_pair(0.5)
    assert device.state is Lifecycle.ACTIVE
    peers[1].fault("normal")
    assert device.grab_pair(HANG_LIMIT_S).validity is Validity.OK


@pytest.mark.hazard(4)
def test_a_camera_whose_power_went_latches_a_fault(pair, peers):
    peers[0].kill()
    with pytest.raises(CameraLost, match=f"GEV-014: {peers[0].address}"):
        pair.grab_pair(HANG_LIMIT_S)
    assert pair.state is Lifecycle.FAULT


def test_settings_that_may_have_been_taken_or_not_are_a_fault(make_pair, peers):
    device = make_pair(heartbeat_ms=60_000)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    peers[1].fault("mute")
    with pytest.raises(CameraLost, match=f"GEV-014.*{peers[1].address}: no reply"):
        device.set_exposure(500.0, 40, 0.5)
    assert device.state is Lifecycle.FAULT


def test_a_camera_that_lets_go_is_noticed_by_the_heartbeat(pair, peers):
    peers[0].fault("let-go")
    eventually(lambda: any(camera.lost for camera in pair._pair))
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
    eventually(lambda: any(camera.lost for camera in pair._pair))
    with pytest.raises(ControlLost):
        pair.grab_pair(1.0)
    with pytest.raises(PersonNotNamed, match="DEV-006"):
        pair.recover("  ")


@pytest.mark.hazard(4)
def test_a_killed_receiver_process_is_a_fault_and_recover_restarts_it(pair):
    os.kill(pair._receiver_process.pid, signal.SIGKILL)
    with pytest.raises(ReceiverEnded, match="GEV-017"):
        pair.grab_pair(HANG_LIMIT_S)
    assert pair.state is Lifecycle.FAULT
    pair.recover("a tester", HANG_LIMIT_S)
    pair.activate(HANG_LIMIT_S)
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK
