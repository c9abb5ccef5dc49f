"""Hazard 17: no tool is taken for another."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from coded_errors import raises

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import FOREIGN_TOOL
from drivers.ndi_polaris.shipped_tools import FOLDER as SHIPPED_DEFINITIONS
from ronna_hw.clock import open_clock
from ronna_hw.config import parse_theatre
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene

TOOL = "robot_frame"


@pytest.mark.hazard(17)
def test_a_definition_replaced_after_the_theatre_was_set_up_is_refused(tmp_path: Path) -> None:
    rom = tmp_path / "robot_frame.rom"
    shutil.copy(SHIPPED_DEFINITIONS / "robot_frame.rom", rom)
    endpoints = {
        "polaris": "tcp://127.0.0.1:8765",
        "kuka": {"rsi": "udp://127.0.0.1:1", "eki_project": "tcp://127.0.0.1:2"},
        "basler": {"left": "gev://127.0.0.2", "right": "gev://127.0.0.3"},
    }
    theatre = parse_theatre(theatre_content(load_scene("mini"), endpoints, "host:", {TOOL: str(rom)}, 1.0))
    assert theatre.tracker is not None
    PolarisTracker("tracker", theatre.tracker, open_clock("host:"))
    shutil.copy(SHIPPED_DEFINITIONS / "x_frame.rom", rom)
    with raises(FOREIGN_TOOL, match=r"NDI-013.*robot_frame"):
        PolarisTracker("tracker", theatre.tracker, open_clock("host:"))
