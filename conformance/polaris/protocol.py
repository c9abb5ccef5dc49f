"""Cases of the suite for devices on the NDI Polaris protocol, in the order of the checklist."""

from __future__ import annotations

from conformance.case import CHECKED_REPLIES
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris import (
    alarm_cases,
    driver_cases,
    frame_cases,
    handle_cases,
    line_cases,
    volume_cases,
)
from conformance.polaris.checklist import POLARIS_CHECKLIST
from conformance.polaris.suite import (
    POLARIS_BYTES,
    SERIAL_LINE,
    TOOL_DEFINITION,
    HoldsDefinitions,
)
from conformance.protocol import ProtocolCases

CASE_MODULES = (
    line_cases,
    handle_cases,
    frame_cases,
    volume_cases,
    driver_cases,
    alarm_cases,
)


def offers(dut: DeviceUnderTest) -> frozenset[str]:
    """Which needs of the Polaris cases the device under test meets."""
    met = {CHECKED_REPLIES}
    if dut.config.endpoint is not None:
        met.add(POLARIS_BYTES)
        if dut.endpoint.scheme == "serial":
            met.add(SERIAL_LINE)
    tracker = dut.make()
    if isinstance(tracker, HoldsDefinitions) and tracker.definition_blocks:
        met.add(TOOL_DEFINITION)
    return frozenset(need.name for need in met)


def simulator() -> tuple[str, ...]:
    """Arguments of `ronna-sim` for a simulated unit."""
    return ("polaris",)


PROTOCOL = ProtocolCases(
    cases=tuple(
        sorted(
            (case for module in CASE_MODULES for case in module.CASES.cases),
            key=lambda case: ("PD".index(case.number[0]), case.number[1:]),
        )
    ),
    checklist=POLARIS_CHECKLIST,
    offers=offers,
    simulator=simulator,
)
