"""The tracker's driver on a line in real time, and for a very long time."""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from machine_stalls import MachineStalls, before_everything_else

from drivers.ndi_polaris import PolarisTracker
from ronna_hw.child_process import ChildProcess, command
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import Validity
from ronna_hw.wire.polaris import FRAME_RATE_HZ
from sim.polaris.definition import write_definition
from sim.theatre.process import load_scene
from sim.theatre.scene import TrackerTool
from sim.theatre.world import World

BAUD = 230_400
FRAMES = 1_000_000
SETTLED = FRAMES // 10  # by then everything that is kept for a while is full
GROWTH_LIMIT_BYTES = 4_000_000  # less than five bytes per frame
MACHINES_SHARE_LIMIT = 0.02  # of the frames; beyond it the machine is too busy to tell
MORE_STRAYS_MM = (
    (60.0, -350.0, -1450.0),
    (-60.0, 350.0, -1550.0),
    (10.0, 60.0, -1350.0),
    (40.0, -60.0, -1450.0),
    (-40.0, 300.0, -1650.0),
)  # beside the three of the bench
STRAYS = 8
POINTER = TrackerTool(
    name="pointer",
    part_number="8700340",
    markers_mm=((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
)


@contextmanager
def tracking(folder: Path, *options: str, paced: bool) -> Iterator[tuple[PolarisTracker, int]]:
    """A driver that tracks two tools and eight strays, and the process number of the unit."""
    rom = folder / "pointer.rom"
    rom.write_bytes(write_definition(POINTER))
    bench = load_scene("bench")
    strays = (*bench.tracker.strays_mm, *MORE_STRAYS_MM)
    scene = bench.model_copy(update={"tracker": bench.tracker.model_copy(update={"strays_mm": strays})})
    world = World.create(scene, paced=paced)
    with ExitStack() as stack:
        arguments = command("sim.cli", "polaris", "--world", world.endpoint, *options)
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        tools = [{"name": "robot_frame", "rom": "robot_frame.rom"}, {"name": "pointer", "rom": str(rom)}]
        tracker = PolarisTracker(
            "tracker",
            DeviceConfig(
                driver="ndi_polaris",
                endpoint=unit.ready["endpoint"],
                options={"tools": tools, "maximum_baud": BAUD},
            ),
            HostClock(),
        )
        stack.callback(tracker.close)
        tracker.connect()
        tracker.configure()
        tracker.activate()
        yield tracker, unit.process.pid


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "minutes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.soak)]
)
def test_at_230400_baud_no_frame_is_missed(
    tmp_path: Path, minutes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    moments: list[tuple[float, int]] = []  # when a reply had come, and the frame in it
    with (
        before_everything_else() as preferred,
        MachineStalls() as stalls,
        tracking(tmp_path, "--throttle", paced=True) as (tracker, _),
    ):
        assert tracker.baud == BAUD
        began_s = time.monotonic()
        while time.monotonic() - began_s < minutes * 60.0:
            frame = tracker.read_frame()
            assert frame.stamp.device_clock is not None
            moments.append((time.monotonic(), frame.stamp.device_clock))
            assert [tool.validity for tool in frame.tools] in ([Validity.OK] * 2, [Validity.STALE] * 2)
            assert len(frame.strays) == STRAYS
        statistics = tracker.statistics
    ours = machines = 0
    # A frame is missed between two replies because of what held up either of them.
    for (begin_s, _), (_, before), (end_s, after) in zip(moments, moments[1:], moments[2:], strict=False):
        missed = max(0, after - before - 1)
        if stalls.overlap(begin_s, end_s):
            machines += missed
        else:
            ours += missed
    frames = moments[-1][1] - moments[0][1]
    with capsys.disabled():
        print(
            f"\n{frames} frames, {statistics.frames} readings, {statistics.repeated} repeated, "
            f"missed {ours}, and {machines} while the machine held up every line ({len(stalls.spans)} times)"
            f"{'' if preferred else '; without real-time priority'}"
        )
    assert frames >= 0.99 * minutes * 60.0 * FRAME_RATE_HZ
    assert ours == 0
    assert machines <= MACHINES_SHARE_LIMIT * frames


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_a_million_frames_over_the_line_leave_no_memory_behind_on_either_side(tmp_path: Path) -> None:
    with tracking(tmp_path, "--endpoint", "tcp://127.0.0.1:0", paced=False) as (tracker, unit_pid):

        def read(frames: int) -> None:
            for _ in range(frames):
                tracker.read_frame()

        read(SETTLED)
        gc.collect()
        before = [resident_bytes("self"), resident_bytes(str(unit_pid))]
        read(FRAMES - SETTLED)
        gc.collect()
        after = [resident_bytes("self"), resident_bytes(str(unit_pid))]
        assert tracker.statistics.frames == FRAMES
        assert tracker.statistics.repeated == tracker.statistics.missed == 0
    assert max(b - a for a, b in zip(before, after, strict=True)) < GROWTH_LIMIT_BYTES, (before, after)


def resident_bytes(process: str) -> int:
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()
