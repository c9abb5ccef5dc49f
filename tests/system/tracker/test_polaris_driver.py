"""The tracker driver and the simulated unit over real lines, each in its own process."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.tool_definition import encode_definition, make_planar_tool
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import make_device

ENDPOINTS = ("serial-pty", "tcp://127.0.0.1:0")
POINTER = make_planar_tool(
    "POINTER",
    ((0.0, 0.0, 0.0), (0.0, 110.0, 0.0), (52.0, 140.0, 0.0), (-35.0, 33.0, 0.0)),
    manufacturer="TEST",
    made_on=date(2025, 1, 1),
)
TOOLS = [{"name": "robot_frame", "rom": "robot_frame.rom"}]
BENCH_STRAYS_MM = {(0, -200, -1400), (20, 0, -1600), (-20, 200, -1500)}


@contextmanager
def started(endpoint: str) -> Iterator[ChildProcess]:
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris", "--endpoint", endpoint)) as child:
        yield child


@pytest.fixture(scope="module", params=ENDPOINTS, ids=["pty", "tcp"])
def unit(request: pytest.FixtureRequest) -> Iterator[ChildProcess]:
    """A unit that the tests of this file share, one after another as its hosts."""
    with started(request.param) as child:
        yield child


def tracker_at(unit: ChildProcess, **options: Any) -> PolarisTracker:
    options.setdefault("tools", TOOLS)
    config = DeviceConfig(driver="ndi_polaris", endpoint=unit.ready["endpoint"], options=options)
    device = make_device("tracker", config, HostClock())
    assert isinstance(device, PolarisTracker)
    return device


def tracking(unit: ChildProcess, **options: Any) -> PolarisTracker:
    device = tracker_at(unit, **options)
    device.connect()
    device.configure()
    device.activate()
    return device


def test_a_session_from_connect_to_close(unit: ChildProcess) -> None:
    device = tracker_at(unit, expected_model="spectra")
    identity = device.connect()
    assert identity.vendor == "NDI"
    assert re.fullmatch(r"\d{3}\.\d{3}\.\d{3}", identity.firmware)
    device.configure()
    serial = unit.ready["endpoint"].startswith("serial://")
    assert (device.baud is not None) == serial
    if serial:
        assert device.baud is not None
        assert device.baud > 9600
    assert device.volume is not None
    device.activate()
    frame = device.read_frame()
    tool = frame.tool("robot_frame")
    assert tool.validity is Validity.OK
    assert tool.rotation is not None
    assert math.isclose(sum(value * value for value in tool.rotation), 1.0, abs_tol=1e-12)
    assert tool.position_mm is not None
    assert tool.position_mm[2] < -900
    assert {tuple(round(v / 10) * 10 for v in stray.position_mm) for stray in frame.strays} == BENCH_STRAYS_MM
    device.deactivate()
    device.close()
    assert device.state is Lifecycle.CLOSED


@pytest.mark.parametrize("reply", ["BX", "TX"])
def test_two_tools_and_strays_are_read_with_either_reply(
    unit: ChildProcess, tmp_path: Path, reply: str
) -> None:
    (tmp_path / "pointer.rom").write_bytes(encode_definition(POINTER))
    tools = [*TOOLS, {"name": "pointer", "rom": str(tmp_path / "pointer.rom")}]
    device = tracking(unit, tools=tools, reply=reply)
    places = []
    for _ in range(100):
        frame = device.read_frame()
        assert [reading.tool for reading in frame.tools] == ["robot_frame", "pointer"]
        assert all(reading.validity is Validity.OK for reading in frame.tools)
        assert len(frame.strays) == 3
        places.append(frame.tool("pointer").position_mm)
    assert all(math.dist(place, places[0]) < 3.0 for place in places if place and places[0])
    device.close()
