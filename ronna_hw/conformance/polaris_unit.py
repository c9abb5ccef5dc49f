"""All cases about a Polaris unit and its driver, in the order of the checklist."""

from __future__ import annotations

from ronna_hw.conformance import (  # each adds its cases to the suite
    polaris_alarms,
    polaris_driver,
    polaris_faults,
    polaris_frames,
    polaris_handles,
    polaris_line,
    polaris_sight,
)
from ronna_hw.conformance.polaris_cases import POLARIS_UNIT

__all__ = ["POLARIS_UNIT"]

CASE_MODULES = (
    polaris_line,
    polaris_handles,
    polaris_frames,
    polaris_sight,
    polaris_faults,
    polaris_driver,
    polaris_alarms,
)

POLARIS_UNIT.cases.sort(key=lambda case: ("PD".index(case.number[0]), case.number[1:]))
