"""The tracker's driver on a line in real time, and for a very long time."""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest
from real_time import before_everything_else, used_s

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
WIRE_S = (12 + 193) * 10 / BAUD  # BX:1801 with its CRC, and its reply; ten bits a byte
HELD_UP_S = 0.005  # of 16.7 ms between two frames the wire takes 9, and work on both sides less than 2
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


@dataclass(frozen=True)
class Exchange:
    """One reading: the frame it told, how long it took, and how much of that was neither work nor wire."""

    count: int
    took_s: float
    waited_s: float


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "minutes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.soak)]
)
def test_at_230400_baud_no_frame_is_missed(
    tmp_path: Path, minutes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    exchanges: list[Exchange] = []
    with (
        before_everything_else() as preferred,
        tracking(tmp_path, "--throttle", paced=True) as (tracker, unit),
    ):
        assert tracker.baud == BAUD
        gc.collect()
        gc.freeze()  # no reading should wait for what pytest has loaded
        began_s = before_s = time.monotonic()
        before_used_s = time.process_time() + used_s(unit)
        while before_s - began_s < minutes * 60.0:
            frame = tracker.read_frame()
            now_s, now_used_s = time.monotonic(), time.process_time() + used_s(unit)
            took_s, used = now_s - before_s, now_used_s - before_used_s
            before_s, before_used_s = now_s, now_used_s
            assert frame.stamp.device_clock is not None
            waited_s = max(0.0, took_s - used - WIRE_S)
            exchanges.append(Exchange(frame.stamp.device_clock, took_s, waited_s))
            assert [tool.validity for tool in frame.tools] in ([Validity.OK] * 2, [Validity.STALE] * 2)
            assert len(frame.strays) == STRAYS
        statistics = tracker.statistics
        gc.unfreeze()
    ours = machines = 0
    # Which frame a reply tells is settled when its request arrives: the reply before counts as well.
    for one, next_one in pairwise(exchanges):
        missed = max(0, next_one.count - one.count - 1)
        if one.waited_s + next_one.waited_s > HELD_UP_S:
            machines += missed
        else:
            ours += missed
    frames = exchanges[-1].count - exchanges[0].count
    typical_s = median(exchange.took_s for exchange in exchanges)
    with capsys.disabled():
        print(
            f"\n{frames} frames, {statistics.frames} readings, {statistics.repeated} repeated, "
            f"missed {ours}, and {machines} while the machine held something up; "
            f"a reading took {typical_s * 1e3:.1f} ms, {WIRE_S * 1e3:.1f} of them on the wire"
            f"{'' if preferred else '; without real-time priority'}"
        )
    assert frames >= 0.99 * minutes * 60.0 * FRAME_RATE_HZ
    assert ours == 0
    assert machines <= MACHINES_SHARE_LIMIT * frames
    assert typical_s < WIRE_S + HELD_UP_S


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
