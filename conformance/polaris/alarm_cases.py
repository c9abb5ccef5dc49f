"""Checklist lines 42 and 43: how the driver handles the system status."""

from __future__ import annotations

from conformance.case import CaseList, check, refused
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.driver_cases import PATIENT_S, TAPPED, reading_command, tapped
from conformance.polaris.tap import with_system_status
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import DeviceError, StateError
from ronna_hw.wire.polaris import PARAMETER_NEW_ALERTS, Alert, SystemStatus

CASES = CaseList()
case = CASES.case


@case("D42", "on system status 0100 the driver reads the alerts; a bump latches a fault", needs=TAPPED)
def bump_is_a_fault(dut: DeviceUnderTest) -> None:
    with tapped(dut) as (tap, tracker):
        name = reading_command(tap)
        tap.change(name, lambda reply: with_system_status(reply, SystemStatus.DIAGNOSTICS_PENDING))
        tap.answer("GET", f"{PARAMETER_NEW_ALERTS}={int(Alert.BUMP)}")
        error = refused(lambda: tracker.read_frame(PATIENT_S), DeviceError, "a reading from a bumped unit")
        check(bool(error.code), "an error with a code", repr(error))
        check(tap.count(f"GET:{PARAMETER_NEW_ALERTS}") > 0, "a read of the alerts", tap.commands[-3:])
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
        refused(lambda: tracker.read_frame(PATIENT_S), StateError, "read_frame in fault")


@case("D43", "on system status 0200 poses are withheld until it clears", needs=TAPPED)
def temperature_is_a_hold(dut: DeviceUnderTest) -> None:
    with tapped(dut) as (tap, tracker):
        tap.change(reading_command(tap), lambda reply: with_system_status(reply, SystemStatus.TEMPERATURE))
        refused(
            lambda: tracker.read_frame(PATIENT_S),
            DeviceError,
            "a reading from a unit that is too cold or too hot",
        )
        check(tracker.state is Lifecycle.HOLD, "state hold", tracker.state)
        tracker.read_frame(PATIENT_S)
        check(tracker.state is Lifecycle.ACTIVE, "state active when it has cleared", tracker.state)


@case("D43b", "on system status 0010 no more poses are used", needs=TAPPED)
def hardware_failure_is_a_fault(dut: DeviceUnderTest) -> None:
    with tapped(dut) as (tap, tracker):
        tap.change(
            reading_command(tap), lambda reply: with_system_status(reply, SystemStatus.HARDWARE_FAILURE)
        )
        refused(lambda: tracker.read_frame(PATIENT_S), DeviceError, "a reading from a faulty unit")
        check(tracker.state is Lifecycle.FAULT, "state fault", tracker.state)
