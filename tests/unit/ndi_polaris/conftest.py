"""Tracker on a unit in the test's own process."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from typing import Any

import pytest
from polaris_unit_in_process import StillClock, UnitInProcess, bring_up, tracker_on

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.tool_definition import ToolDefinition, make_planar_tool


@pytest.fixture
def unit() -> UnitInProcess:
    return UnitInProcess()


@pytest.fixture
def clock() -> StillClock:
    return StillClock()


@pytest.fixture
def make_tracker(unit: UnitInProcess, clock: StillClock) -> Callable[..., PolarisTracker]:
    def make(**options: Any) -> PolarisTracker:
        return tracker_on(unit, clock, "serial:///dev/null", **options)

    return make


@pytest.fixture
def tracker(make_tracker: Callable[..., PolarisTracker]) -> PolarisTracker:
    """Return a tracker that is tracking."""
    return bring_up(make_tracker())


@pytest.fixture
def pointer() -> ToolDefinition:
    """Return a tool that is not the robot's frame."""
    return make_planar_tool(
        "POINTER",
        ((0.0, 0.0, 0.0), (0.0, 110.0, 0.0), (52.0, 140.0, 0.0), (-35.0, 33.0, 0.0)),
        manufacturer="TEST",
        made_on=date(2025, 1, 1),
    )
