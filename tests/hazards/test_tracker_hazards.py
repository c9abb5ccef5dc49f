"""Hazards 14 and 17: a tool the tracker does not see has no pose; no tool is taken for another."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import ForeignTool
from drivers.ndi_polaris.tools.shipped import FOLDER as SHIPPED_DEFINITIONS
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig, parse_theatre
from ronna_hw.devices.readings import Validity
from ronna_hw.host.child_process import ChildProcess, command
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene
from sim.world.world import World

TOOL = "robot_frame"
STRAYS = 3  # of the bench scene


@pytest.fixture
def world() -> World:
    return World.create(load_scene("bench"), paced=False)


@pytest.fixture
def tracker(world: World) -> Iterator[PolarisTracker]:
    arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0", "--world", world.endpoint)
    with ChildProcess("ronna-sim polaris", arguments) as child:
        config = DeviceConfig(
            driver="ndi_polaris",
            endpoint=child.ready["endpoint"],
            options={"tools": [{"name": TOOL, "rom": "robot_frame.rom"}]},
        )
        tracker = PolarisTracker("tracker", config, open_clock(world.clock_endpoint))
        tracker.connect()
        tracker.configure()
        tracker.activate()
        yield tracker
        tracker.close()


@pytest.mark.hazard(14)
def test_a_hidden_tool_is_missing_without_a_pose_and_returns_by_itself(
    world: World, tracker: PolarisTracker
) -> None:
    assert tracker.read_frame().tool(TOOL).validity is Validity.OK
    world.set_fault_script(f"at {world.clock.now_s()} s: tracker occlude tool {TOOL} for 0.5 s")
    hidden = [tracker.read_frame().tool(TOOL) for _ in range(10)]
    assert {reading.validity for reading in hidden} == {Validity.MISSING}
    assert {(reading.position_mm, reading.rotation) for reading in hidden} == {(None, None)}
    world.clock.sleep(0.5)
    assert tracker.read_frame().tool(TOOL).position_mm is not None


@pytest.mark.hazard(14)
def test_hiding_a_tool_assigns_none_of_the_other_spheres_to_it(world: World, tracker: PolarisTracker) -> None:
    assert len(tracker.read_frame().strays) == STRAYS
    world.set_fault_script(f"at {world.clock.now_s()} s: tracker occlude tool {TOOL} for 0.5 s")
    frame = tracker.read_frame()
    assert frame.tool(TOOL).position_mm is None
    assert len(frame.strays) == STRAYS


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
    with pytest.raises(ForeignTool, match=r"NDI-013.*robot_frame"):
        PolarisTracker("tracker", theatre.tracker, open_clock("host:"))
