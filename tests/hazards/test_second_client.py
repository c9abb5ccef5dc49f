"""Hazard 34: another client of the tracker's network port is refused, or detected from the unit's replies.

A unit with one connection lets a second program wait and answers it nothing. One that serves several hands
out one state to all of them: the driver sees from the replies that it is no longer the only one.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from polaris_unit_in_process import StillClock, UnitInProcess, bring_up, tracker_on

from drivers.ndi_polaris import PolarisTracker
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command

IMPATIENT_S = 1.5  # host time that the second client waits


@pytest.fixture
def unit_on_a_port() -> Iterator[str]:
    words = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0")
    with ChildProcess("ronna-sim polaris", words) as child:
        yield str(child.ready["endpoint"])


def tracker_at(endpoint: str) -> PolarisTracker:
    tools = [{"name": "robot_frame", "rom": "robot_frame.rom"}]
    config = DeviceConfig(driver="ndi_polaris", endpoint=endpoint, options={"tools": tools})
    return PolarisTracker("tracker", config, HostClock())


@pytest.mark.hazard(34)
def test_a_second_client_gets_no_answer_and_the_first_keeps_tracking(unit_on_a_port: str) -> None:
    first, second = tracker_at(unit_on_a_port), tracker_at(unit_on_a_port)
    first.connect()
    first.configure()
    first.activate()
    try:
        before = first.read_frame().stamp.device_clock
        with pytest.raises(RonnaError) as refused:
            second.connect(IMPATIENT_S)
        assert refused.value.code.startswith("NDI-")
        assert second.state is not Lifecycle.CONNECTED
        after = first.read_frame()
        assert after.validity is Validity.OK
        assert after.stamp.device_clock > before
        assert first.fault is None
    finally:
        second.close()
        first.close()


@pytest.mark.hazard(34)
def test_a_second_client_that_ends_tracking_is_detected_at_the_next_frame() -> None:
    unit = UnitInProcess()
    tracker = bring_up(tracker_on(unit, StillClock(), "tcp://127.0.0.1:8765"))
    tracker.read_frame()
    unit.tracking = False
    with pytest.raises(RonnaError, match="NDI-0"):
        tracker.read_frame()
    assert tracker.state is Lifecycle.FAULT
