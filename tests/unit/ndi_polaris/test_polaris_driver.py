"""The driver as an optical tracker: its calls, their order, and closing."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import LinkLost, NoReply
from ronna_hw.devices import LastKnown, Lifecycle, OpticalTracker
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.errors import WrongState

Make = Callable[..., PolarisTracker]


def test_the_driver_is_an_optical_tracker(make_tracker: Make) -> None:
    assert isinstance(make_tracker(), OpticalTracker)


def test_calls_out_of_order_are_refused(make_tracker: Make) -> None:
    device = make_tracker()
    for call in (device.configure, device.activate, device.deactivate, device.read_frame):
        with pytest.raises(WrongState):
            call()
    device.connect()
    with pytest.raises(WrongState):
        device.connect()
    device.configure()
    device.activate()
    with pytest.raises(WrongState):
        device.activate()
    with pytest.raises(WrongState):
        device.recover("tester")


def test_the_tracker_can_be_observed_in_every_state(make_tracker: Make) -> None:
    device = make_tracker()
    assert device.observe() == LastKnown(Lifecycle.DISCONNECTED, None, None)
    with device.active():
        frame = device.read_frame()
        assert device.observe() == LastKnown(Lifecycle.ACTIVE, None, frame)
    device.close()
    assert device.observe() == LastKnown(Lifecycle.CLOSED, None, frame)


def test_a_reply_that_had_to_be_requested_again_is_counted_where_the_tracker_is_observed(
    tracker: PolarisTracker, unit: Any
) -> None:
    usual = unit.deliver

    def spoilt_once(command: str, reply: bytes) -> Any:
        if command == "BX":
            unit.deliver = usual
            reply = reply[:-1] + bytes([reply[-1] ^ 1])
        return usual(command, reply)

    unit.deliver = spoilt_once
    tracker.read_frame()
    assert tracker.observe().says == (Fact("disturbed replies", "1"),)


def test_tracking_stops_and_restarts_at_frame_0(tracker: PolarisTracker) -> None:
    for _ in range(3):
        tracker.read_frame()
    tracker.deactivate()
    assert tracker.state is Lifecycle.CONFIGURED
    tracker.activate()
    assert tracker.read_frame().stamp.device_clock == 0


def test_activate_can_be_repeated_after_a_lost_reply(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    device.configure()
    lost = iter([True])
    unit.deliver = lambda name, reply: [] if name == "TSTART" and next(lost, False) else [(0.001, reply)]
    with pytest.raises(NoReply):
        device.activate()
    device.activate()
    assert device.read_frame().stamp.device_clock == 0


def test_closing_restores_the_units_power_up_state(tracker: PolarisTracker, unit: Any) -> None:
    tracker.close()
    assert not unit.tracking
    assert unit.handles == {}
    assert unit.unit_baud == 9600
    assert tracker.state is Lifecycle.CLOSED
    tracker.close()


def test_closing_a_dead_link_is_bounded_and_raises_nothing(tracker: PolarisTracker, unit: Any) -> None:
    unit.silent = True
    began_s = unit.now_s
    tracker.close()
    assert unit.now_s - began_s <= 1.6
    assert tracker.state is Lifecycle.CLOSED


def test_closing_after_the_port_vanished_raises_nothing(tracker: PolarisTracker, unit: Any) -> None:
    unit.closed = True
    with pytest.raises(LinkLost):
        tracker.read_frame()
    tracker.close()
    assert tracker.state is Lifecycle.CLOSED


@pytest.mark.slow
def test_reading_frames_leaks_no_memory(tracker: PolarisTracker, unit: Any, clock: Any) -> None:
    """The million frames are read by `make soak`."""

    def read(frames: int) -> None:
        for _ in range(frames):
            clock.time_s += 1 / 60
            tracker.read_frame()
            unit.commands.clear()

    read(60 * 70)  # more than the minute that the fit of the clock keeps
    tracemalloc.start()
    read(100)
    before, _ = tracemalloc.get_traced_memory()
    read(2000)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20_000  # ten bytes per frame would be found
