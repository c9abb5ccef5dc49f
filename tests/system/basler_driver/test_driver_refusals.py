"""Whom the stereo driver does not accept: nobody, another model, the wrong side, a second controller."""

from __future__ import annotations

import pytest
from peer_cameras import HANG_LIMIT_S, SERIALS, free_address

from drivers.basler_stereo.errors import (
    CablesSwapped,
    ControlTaken,
    NoCamera,
    PacketTooLarge,
    WrongModel,
    WrongSerial,
)
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.readings import Validity


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
        make_pair(left=other).connect(HANG_LIMIT_S)


@pytest.mark.hazard(25)
def test_swapped_cables_are_told_from_a_wrong_camera(make_pair, peers):
    with pytest.raises(CablesSwapped, match="GEV-004"):
        make_pair(left=peers[1], right=peers[0]).connect(HANG_LIMIT_S)
    with pytest.raises(WrongSerial, match="GEV-003"):
        make_pair(right_serial="21900009").connect(HANG_LIMIT_S)
    with pytest.raises(WrongSerial, match="GEV-003"):
        make_pair(left=peers[0], right=peers[0]).connect(HANG_LIMIT_S)


@pytest.mark.hazard(34)
def test_a_second_controller_is_refused_and_the_first_goes_on(pair, make_pair):
    second = make_pair()
    second.connect(HANG_LIMIT_S)
    with pytest.raises(ControlTaken, match="GEV-005"):
        second.configure(HANG_LIMIT_S)
    assert second.state is Lifecycle.CONNECTED
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK


def test_after_a_failed_configure_neither_camera_is_controlled(make_pair, peers):
    peers[1].fault("taken")
    device = make_pair()
    device.connect(HANG_LIMIT_S)
    with pytest.raises(ControlTaken):
        device.configure(HANG_LIMIT_S)
    peers[1].fault("normal")
    device.configure(HANG_LIMIT_S)
    assert device.state is Lifecycle.CONFIGURED


def test_a_packet_size_that_does_not_arrive_is_refused(make_pair, make_peer):
    narrow = make_peer(SERIALS[0], "--largest-packet", "1500").ready()
    device = make_pair(left=narrow, packet_bytes=8000)
    device.connect(HANG_LIMIT_S)
    with pytest.raises(PacketTooLarge, match=r"GEV-012: packets of 8000 .* limit 1500 bytes"):
        device.configure(HANG_LIMIT_S)


def test_without_a_wish_the_largest_packets_that_arrive_are_used(make_pair, make_peer):
    narrow = make_peer(SERIALS[0], "--largest-packet", "1500").ready()
    device = make_pair(left=narrow)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    device.grab_pair(HANG_LIMIT_S)
    # 32768 bytes in packets of 1464 and 8156 bytes of data, with leader and trailer
    assert [counters.packets for counters in device.counters] == [23 + 2, 5 + 2]
    assert device.notices == ()


def test_a_camera_without_test_packets_is_believed(make_pair, make_peer):
    silent = make_peer(SERIALS[0], "--largest-packet", "0").ready()
    device = make_pair(left=silent)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    assert any("no test packets" in notice for notice in device.notices)
