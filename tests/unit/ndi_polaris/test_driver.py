"""The driver as an optical tracker: its calls, their order, and closing."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest
from coded_errors import raises
from polaris_unit_in_process import StillClock, configured

from drivers.ndi_polaris import PolarisTracker, errors
from drivers.ndi_polaris.errors import NoReply
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import LastKnown
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.errors import PersonNotNamed
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.endpoints import BadEndpoint, parse_endpoint
from ronna_hw.errors import EXIT_LINK_LOST, EXIT_SAFETY_STOP
from ronna_hw.wire.polaris import ERROR_MEANINGS

Make = Callable[..., PolarisTracker]


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


def test_activate_can_be_repeated_after_a_lost_reply(make_tracker: Make, unit: Any) -> None:
    device = configured(make_tracker())
    lost = iter([True])
    unit.deliver = lambda name, reply: [] if name == "TSTART" and next(lost, False) else [(0.001, reply)]
    with pytest.raises(NoReply):
        device.activate()
    device.activate()
    assert device.read_frame().stamp.device_clock == 0


def test_closing_a_dead_link_is_bounded_and_raises_nothing(tracker: PolarisTracker, unit: Any) -> None:
    unit.silent = True
    began_s = unit.now_s
    tracker.close()
    assert unit.now_s - began_s <= 1.6
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


@pytest.mark.parametrize("vendor_code", sorted(ERROR_MEANINGS))
def test_each_vendor_error_becomes_a_typed_error_with_its_meaning(vendor_code: int) -> None:
    error = errors.error_for(vendor_code, "PINIT")
    assert isinstance(error, errors.UnitError)
    assert error.vendor_code == vendor_code
    assert ERROR_MEANINGS[vendor_code] in str(error)
    assert str(error).startswith(error.code)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("ERROR23", errors.CommandRejected),
        ("ERROR04", errors.CommandGarbled),
        ("ERROR0C", errors.WrongMode),
        ("ERROR2D", errors.HandleRefused),
        ("ERROR13", errors.ToolRefused),
        ("ERROR40", errors.ToolRefused),
        ("ERROR33", errors.NotOffered),
        ("ERROR1A", errors.UnitFault),
        ("ERROREE", errors.UnitFault),
    ],
)
def test_a_unit_error_is_raised_as_its_own_type(
    make_tracker: Make, unit: Any, text: str, kind: type[errors.UnitError]
) -> None:
    device = make_tracker()
    device.connect()
    unit.answers_to["PHRQ"] = text
    with raises(kind):
        device.configure(60.0)
    assert device.state is Lifecycle.CONNECTED


def test_a_unit_that_cannot_initialise_is_reported(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["INIT"] = "ERROR10"
    with pytest.raises(errors.NotInitialised):
        make_tracker().connect(60.0)


def test_an_endpoint_of_another_kind_is_refused() -> None:
    with pytest.raises(BadEndpoint):
        PolarisTracker("t", DeviceConfig(driver="ndi_polaris", endpoint="udp://127.0.0.1:1"), StillClock())
    assert parse_endpoint("serial:///dev/ttyUSB0").scheme == "serial"


def test_a_device_of_another_make_is_refused(make_tracker: Make, unit: Any) -> None:
    unit.answers_to["VER"] = "Aurora Control Firmware"
    with pytest.raises(errors.NotAPolaris, match="Aurora"):
        make_tracker().connect()


@pytest.mark.parametrize("wish", [{"expected_model": "vicra"}, {"expected_serial": "P7-99999"}])
def test_a_unit_other_than_the_expected_one_is_refused(make_tracker: Make, wish: dict[str, str]) -> None:
    with raises(errors.WRONG_UNIT):
        make_tracker(**wish).connect()


@pytest.mark.hazard(4)
def test_a_lost_link_latches_a_fault_and_closes_without_an_error(tracker: PolarisTracker, unit: Any) -> None:
    unit.closed = True
    with pytest.raises(errors.LinkLost) as caught:
        tracker.read_frame()
    assert caught.value.exit_code == EXIT_LINK_LOST
    assert tracker.state is Lifecycle.FAULT
    assert tracker.fault is caught.value
    tracker.close()
    assert tracker.state is Lifecycle.CLOSED


def test_tracking_that_stopped_by_itself_is_reported_as_a_restart(tracker: PolarisTracker, unit: Any) -> None:
    unit.tracking = False
    with pytest.raises(errors.UnitRestarted, match="no longer tracking"):
        tracker.read_frame()


def test_a_frame_number_that_goes_backwards_is_reported_as_a_restart(
    tracker: PolarisTracker, unit: Any
) -> None:
    for _ in range(10):
        tracker.read_frame()
    unit.frame = -1
    with pytest.raises(errors.UnitRestarted, match="backwards"):
        tracker.read_frame()
    assert tracker.state is Lifecycle.FAULT


@pytest.mark.hazard(15)
def test_a_bump_is_latched_and_cleared_by_a_named_recovery(tracker: PolarisTracker, unit: Any) -> None:
    unit.system_status = 0x0100
    unit.parameters["Info.Status.New Alerts"] = str(1 << 21)
    unit.parameters["Param.Bump Detector.Bumped"] = "1"
    with pytest.raises(errors.SensorBumped) as caught:
        tracker.read_frame()
    assert caught.value.exit_code == EXIT_SAFETY_STOP
    assert tracker.state is Lifecycle.FAULT
    with pytest.raises(PersonNotNamed, match="DEV-006"):
        tracker.recover(" ")
    tracker.recover("tester")
    assert unit.parameters["Param.Bump Detector.Bumped"] == "0"
    assert tracker.state is Lifecycle.CONFIGURED


def test_alerts_of_thousands_of_digits_are_a_malformed_reply(tracker: PolarisTracker, unit: Any) -> None:
    unit.system_status = 0x0100
    unit.parameters["Info.Status.New Alerts"] = "1" * 5000
    with pytest.raises(errors.MalformedReply, match="unknown format of the alerts"):
        tracker.read_frame()


def test_recovery_with_another_unit_is_refused(tracker: PolarisTracker, unit: Any) -> None:
    unit.closed = True
    with pytest.raises(errors.LinkLost):
        tracker.read_frame()
    unit.closed = False
    unit.restart()
    unit.answers_to["VER"] = "Polaris Spectra Control Firmware\nNDI S/N: P7-77777"
    with raises(errors.WRONG_UNIT):
        tracker.recover("tester")
    assert tracker.state is Lifecycle.FAULT


@pytest.mark.hazard(15)
def test_a_temperature_alert_holds_the_tracker_and_clears_by_itself(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.system_status = 0x0200
    with pytest.raises(errors.TemperatureHold):
        tracker.read_frame()
    assert tracker.state is Lifecycle.HOLD
    unit.system_status = 0
    assert tracker.read_frame().tool("robot_frame").position_mm
    assert tracker.state is Lifecycle.ACTIVE


def test_an_alert_that_affects_no_pose_is_read_and_tracking_continues(
    tracker: PolarisTracker, unit: Any
) -> None:
    unit.system_status = 0x0100
    unit.parameters["Info.Status.New Alerts"] = str(1 << 20)
    tracker.read_frame()
    assert tracker.state is Lifecycle.ACTIVE
    assert unit.parameters["Info.Status.New Alerts"] == "0"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tools": "robot_frame.rom"}, "tools"),
        ({"tools": [{"name": "a", "rom": "robot_frame.rom"}] * 2}, "duplicate tool name"),
        ({"illuminator_rate_hz": 50}, "illuminator_rate_hz"),
        ({"maximum_baud": 12345}, r"maximum_baud: expected one of 9600.*\(found 12345\)"),
        ({"colour": "green"}, "colour"),
        ({"time_limits_s": {"NOPE": 1.0}}, "NOPE"),
        ({"tools": [], "reply": "XML", "volume": 0}, "2 mistake"),
    ],
)
def test_wrong_options_are_all_reported_at_once(
    make_tracker: Make, options: dict[str, Any], words: str
) -> None:
    with raises(errors.BAD_OPTIONS, match=words):
        make_tracker(**options)
