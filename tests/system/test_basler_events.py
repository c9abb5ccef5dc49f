"""The simulated cameras report to the stereo driver; a missed trigger becomes a count."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator

import pytest
from faulty_cameras import LIMIT_S, Cameras
from waiting import eventually

from drivers.basler_stereo import BaslerStereoPair
from ronna_hw.devices.readings import Validity
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.wire.gige_vision import Bootstrap

LONG_EXPOSURE_US = 1_000_000.0


@pytest.fixture
def cameras() -> Iterator[Cameras]:
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler")) as child:
        running = Cameras(child)
        yield running
        running.close()


def exposures(pair: BaslerStereoPair) -> list[int]:
    return [counters.exposures for counters in pair.event_counters if counters is not None]


def trigger_left(pair: BaslerStereoPair) -> None:
    """A trigger of the left camera alone, as from somebody who does not wait for it."""
    camera = pair._pair[0]
    assert camera.trigger_command is not None
    camera.control.ask(*camera.trigger_command, time.monotonic() + LIMIT_S, "a trigger")


def test_every_exposure_is_reported_and_a_trigger_that_comes_too_early_is_counted(cameras: Cameras) -> None:
    pair = cameras.streaming(events=True)
    assert pair.notices == ()
    for _ in range(3):
        assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    eventually(lambda: exposures(pair) == [3, 3])
    assert [counters.missed_triggers for counters in pair.event_counters] == [0, 0]
    pair.set_exposure(LONG_EXPOSURE_US, 36)
    left = pair._pair[0]
    for _ in range(4):
        trigger_left(pair)
    missed = left.features.whole("OvertriggerCount")
    assert missed > 0
    eventually(lambda: pair.event_counters[0].missed_triggers == missed)
    assert pair.event_counters[1].missed_triggers == 0


def test_messages_that_get_lost_are_repeated_and_counted_once(cameras: Cameras) -> None:
    pair = cameras.streaming(events=True)
    cameras.fault("lose events both 30 %")
    for _ in range(8):
        assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    eventually(lambda: exposures(pair) == [8, 8])


def test_images_do_not_need_the_events(cameras: Cameras) -> None:
    pair = cameras.streaming(events=True)
    cameras.fault("lose events both 100 %")
    assert pair.grab_pair(LIMIT_S).validity is Validity.OK
    assert exposures(pair) == [0, 0]


def test_without_the_option_nothing_is_asked_for(cameras: Cameras) -> None:
    pair = cameras.streaming()
    assert pair.event_counters == (None, None)
    assert pair._pair[0].control.read_register(Bootstrap.MCP, time.monotonic() + LIMIT_S) == 0


def test_when_control_is_given_back_the_channel_is_closed(cameras: Cameras) -> None:
    pair = cameras.streaming(events=True)
    address = pair._pair[0].control.address
    pair.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(LIMIT_S)
        other.sendto(struct.pack(">BBHHHI", 0x42, 1, 0x80, 4, 1, Bootstrap.MCP), (address, 3956))
        assert other.recv(100)[8:] == bytes(4)
