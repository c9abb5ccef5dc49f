"""All cases about a Polaris unit and its driver, in the order of the checklist."""

from __future__ import annotations

from ronna_hw.conformance.polaris import (  # each adds its cases to the suite
    alarm_cases,
    driver_cases,
    fault_cases,
    frame_cases,
    handle_cases,
    line_cases,
    volume_cases,
)
from ronna_hw.conformance.polaris.suite import POLARIS_UNIT

__all__ = ["POLARIS_UNIT"]

CASE_MODULES = (
    line_cases,
    handle_cases,
    frame_cases,
    volume_cases,
    fault_cases,
    driver_cases,
    alarm_cases,
)

POLARIS_UNIT.cases.sort(key=lambda case: ("PD".index(case.number[0]), case.number[1:]))
