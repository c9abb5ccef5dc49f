"""Every fault of the unit itself, over the wire: what the driver reports, its state, and how it recovers."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.ndi_polaris import PolarisTracker, errors
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command
from sim.world.process import load_scene
from sim.world.world import World

TCP, PTY = "tcp://127.0.0.1:0", "serial-pty"
on_both_lines = pytest.mark.parametrize("unit", [TCP, PTY], ids=["tcp", "pty"], indirect=True)
TOOL = "robot_frame"
LASTS_S = 0.5
READINGS = 60


@pytest.fixture(scope="module")
def world() -> World:
    return World.create(load_scene("bench"), paced=False)


@pytest.fixture(scope="module")
def unit(world: World, request: pytest.FixtureRequest) -> Iterator[ChildProcess]:
    with unit_of(world, getattr(request, "param", TCP)) as child:
        yield child


def unit_of(world: World, endpoint: str = TCP) -> ChildProcess:
    arguments = command("sim.cli", "polaris", "--endpoint", endpoint, "--world", world.endpoint)
    return ChildProcess("ronna-sim polaris", arguments)


@pytest.fixture
def tracker(world: World, unit: ChildProcess) -> Iterator[PolarisTracker]:
    world.set_fault_script("")
    device = tracker_at(unit.ready["endpoint"], world)
    with contextlib.closing(device):
        device.connect()
        device.configure()
        device.activate()
        yield device


def tracker_at(endpoint: str, world: World, **options: Any) -> PolarisTracker:
    options.setdefault("tools", [{"name": TOOL, "rom": "robot_frame.rom"}])
    config = DeviceConfig(driver="ndi_polaris", endpoint=endpoint, options=options)
    return PolarisTracker("tracker", config, open_clock(world.clock_endpoint))


def happen(world: World, fault: str) -> None:
    world.set_fault_script(f"at {world.clock.now_s()} s: tracker {fault}")


def first_trouble(tracker: PolarisTracker) -> RonnaError:
    for _ in range(READINGS):
        try:
            tracker.read_frame()
        except RonnaError as trouble:
            return trouble
    raise AssertionError(f"no trouble in {READINGS} readings")


def sees(frame: TrackerFrame) -> bool:
    return frame.tool(TOOL).validity is Validity.OK


@on_both_lines
@pytest.mark.hazard(15)
@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("bump", errors.SensorBumped),
        (f"alert 4 for {LASTS_S} s", errors.HardwareFailure),
        ("restart", errors.UnitRestarted),
        ("watchdog", errors.UnitRestarted),
    ],
)
def test_a_unit_fault_latches_and_recover_leads_back_to_tracking(
    world: World, tracker: PolarisTracker, fault: str, kind: type[RonnaError]
) -> None:
    assert sees(tracker.read_frame())
    happen(world, fault)
    assert isinstance(first_trouble(tracker), kind)
    assert tracker.state is Lifecycle.FAULT
    assert isinstance(tracker.fault, kind)
    world.clock.sleep(LASTS_S)
    tracker.recover("tester", timeout_s=100.0)
    assert tracker.state is Lifecycle.CONFIGURED
    tracker.activate()
    assert any(sees(tracker.read_frame()) for _ in range(5))


@pytest.mark.hazard(14)
@pytest.mark.parametrize(
    ("fault", "validity", "strays"),  # of the bench scene, and markers that make up no tool
    [
        (f"occlude tool {TOOL}", Validity.MISSING, 3),
        (f"bend tool {TOOL} 20 mm", Validity.MISSING, 7),
        (f"turn tool {TOOL} 120 deg", Validity.MISSING, 7),
        (f"move tool {TOOL} 0 0 -2000 mm", Validity.OUT_OF_VOLUME, 3),
        (f"interference tool {TOOL}", Validity.PARTIAL, 3),
    ],
)
def test_a_visibility_fault_becomes_a_validity_and_clears_by_itself(
    world: World, tracker: PolarisTracker, fault: str, validity: Validity, strays: int
) -> None:
    assert sees(tracker.read_frame())
    happen(world, f"{fault} for {LASTS_S} s")
    for frame in (tracker.read_frame() for _ in range(5)):
        tool = frame.tool(TOOL)
        assert (tool.validity, len(frame.strays)) == (validity, strays)
        assert (tool.position_mm is None) == (tool.rotation is None) == (validity is Validity.MISSING)
    world.clock.sleep(LASTS_S)
    assert sees(tracker.read_frame())
    assert tracker.state is Lifecycle.ACTIVE


@pytest.mark.hazard(4)
def test_a_unit_that_measures_nothing_new_is_stale(world: World, tracker: PolarisTracker) -> None:
    tracker.read_frame()
    happen(world, f"repeat frames for {LASTS_S} s")
    assert Validity.STALE in {tracker.read_frame().validity for _ in range(5)}


def test_frames_skipped_by_the_unit_are_counted(world: World, tracker: PolarisTracker) -> None:
    tracker.read_frame()
    happen(world, f"skip 3 frames for {LASTS_S} s")
    for _ in range(5):
        tracker.read_frame()
    assert tracker.statistics.missed >= 9


@on_both_lines
@pytest.mark.hazard(4)
def test_a_unit_that_lost_power_is_found_again_when_it_is_back(world: World, tracker: PolarisTracker) -> None:
    tracker.read_frame()
    happen(world, f"power off for {LASTS_S} s")
    trouble = [first_trouble(tracker)]
    while tracker.state is Lifecycle.ACTIVE:
        trouble.append(first_trouble(tracker))
    assert isinstance(trouble[-1], errors.LinkLost | errors.UnitRestarted)
    world.clock.sleep(LASTS_S)
    tracker.recover("tester", timeout_s=100.0)
    tracker.activate()
    assert sees(tracker.read_frame())


@pytest.mark.slow
def test_a_stalled_unit_measures_the_same_as_one_that_never_stalled(world: World) -> None:
    world.set_fault_script("")

    def measurements(held_up: int | None) -> list[tuple[object, ...]]:
        """Six of the first tracking session of a unit."""
        found = []
        with unit_of(world) as unit, contextlib.closing(tracker_at(unit.ready["endpoint"], world)) as tracker:
            tracker.connect()
            tracker.configure()
            tracker.activate()
            for number in range(6):
                if number == held_up:
                    os.kill(unit.process.pid, signal.SIGSTOP)
                    with pytest.raises(errors.NoReply):
                        tracker.read_frame(0.2)
                    os.kill(unit.process.pid, signal.SIGCONT)
                frame = tracker.read_frame()
                found.append((frame.stamp.device_clock, frame.tools, frame.strays))
        return found

    assert measurements(held_up=0) == measurements(held_up=3) == measurements(held_up=None)
