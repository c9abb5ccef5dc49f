"""The tracker driver on a line in real time, and over a very long time."""

from __future__ import annotations

import gc
import resource
import time
from array import array
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
import pytest
from numpy.typing import NDArray
from real_time import before_everything_else, used_s

from drivers.ndi_polaris import PolarisTracker
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import Validity
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.wire.polaris import FRAME_RATE_HZ
from sim.polaris.unit.tool_definition import write_definition
from sim.world.process import load_scene
from sim.world.scene.model import TrackerTool
from sim.world.world import World

BAUD = 230_400
FRAMES = 1_000_000
SETTLED = FRAMES // 10  # by then everything that is kept for a while is full
GROWTH_LIMIT_BYTES = 4_000_000  # less than five bytes per frame
WIRE_S = (12 + 193) * 10 / BAUD  # BX:1801 with its CRC, and its reply; ten bits a byte
HELD_UP_S = 0.005  # of 16.7 ms between two frames the wire takes 9, and work on both sides less than 2
MACHINES_SHARE_LIMIT = 0.02  # of the frames; beyond it the machine is too busy to tell
# A virtual machine charges some of its own stalls to whatever runs: a bare loop was charged 8 to 10 ms for
# 9 µs of work, three times in four minutes. Slow work of ours would not be as rare as this share of readings.
CHARGED_TIMES = 5.0  # the usual processor time of a reading
CHARGED_SHARE_LIMIT = 5e-3
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
class Missed:
    """Frames missed between two readings, and where the time of both went.

    Which frame a reply tells is settled when its request arrives: the reply before counts as well.
    """

    frames: int
    at_s: float
    took_s: float
    driver_used_s: float
    unit_used_s: float
    held_up_s: float  # by the machine: waited with nothing to wait for, or charged for what is no work

    @property
    def machines(self) -> bool:
        """Whether it was the machine that made them be missed."""
        return self.held_up_s > HELD_UP_S


class Exchanges:
    """Every reading: the frame it told, how long it took, and the processor time of both processes.

    Kept as bare numbers: objects by the ten thousand would be looked through by each full garbage collection,
    which then takes as long as a frame.
    """

    def __init__(self) -> None:
        self.counts = array("q")
        self.took_s = array("d")
        self.driver_used_s = array("d")
        self.unit_used_s = array("d")

    def add(self, count: int, took_s: float, driver_used_s: float, unit_used_s: float) -> None:
        self.counts.append(count)
        self.took_s.append(took_s)
        self.driver_used_s.append(driver_used_s)
        self.unit_used_s.append(unit_used_s)

    def charged_s(self) -> NDArray[np.float64]:
        """Of each reading, the processor time that either process was charged beyond any work."""
        used_s = np.array([self.driver_used_s, self.unit_used_s])
        most_s = CHARGED_TIMES * np.median(used_s, axis=1, keepdims=True)
        return np.asarray(np.maximum(used_s - most_s, 0.0).sum(axis=0))

    def missed(self) -> list[Missed]:
        """Wherever frames were missed, in the order of time."""
        took_s, driver_s, unit_s = map(np.asarray, (self.took_s, self.driver_used_s, self.unit_used_s))
        charged_s = self.charged_s()
        held_up_s = np.maximum(took_s - driver_s - unit_s - WIRE_S, 0.0) + charged_s
        found = []
        for index, (before, count) in enumerate(pairwise(self.counts)):
            if count > before + 1:
                both = slice(index, index + 2)
                numbers = (took_s[:index], *(each[both] for each in (took_s, driver_s, unit_s, held_up_s)))
                found.append(Missed(count - before - 1, *(float(each.sum()) for each in numbers)))
        return found


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "minutes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.soak)]
)
def test_no_frame_is_missed_at_230400_baud(
    tmp_path: Path, minutes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    exchanges = Exchanges()
    with (
        before_everything_else() as preferred,
        tracking(tmp_path, "--throttle", paced=True) as (tracker, unit),
    ):
        assert tracker.baud == BAUD
        gc.collect()
        gc.freeze()  # no reading should wait for what pytest has loaded
        began_s = before_s = time.monotonic()
        before_used_s = time.process_time(), used_s(unit)
        while before_s - began_s < minutes * 60.0:
            frame = tracker.read_frame()
            now_s, now_used_s = time.monotonic(), (time.process_time(), used_s(unit))
            took_s = now_s - before_s
            driver_s, unit_s = (now - before for now, before in zip(now_used_s, before_used_s, strict=True))
            before_s, before_used_s = now_s, now_used_s
            assert frame.stamp.device_clock is not None
            exchanges.add(frame.stamp.device_clock, took_s, driver_s, unit_s)
            assert [tool.validity for tool in frame.tools] in ([Validity.OK] * 2, [Validity.STALE] * 2)
            assert len(frame.strays) == STRAYS
        statistics = tracker.statistics
        gc.unfreeze()
    missed = exchanges.missed()
    ours = [one for one in missed if not one.machines]
    machines = sum(one.frames for one in missed if one.machines)
    charged = int(np.count_nonzero(exchanges.charged_s()))
    frames = exchanges.counts[-1] - exchanges.counts[0]
    typical_s = median(exchanges.took_s)
    with capsys.disabled():
        print(
            f"\n{frames} frames, {statistics.frames} readings, {statistics.repeated} repeated, "
            f"missed {sum(one.frames for one in ours)}, and {machines} while the machine held something up; "
            f"{charged} readings were charged for more than work; "
            f"a reading took {typical_s * 1e3:.1f} ms, {WIRE_S * 1e3:.1f} of them on the wire"
            f"{'' if preferred else '; without real-time priority'}"
        )
    assert frames >= 0.99 * minutes * 60.0 * FRAME_RATE_HZ
    assert ours == []
    assert charged <= CHARGED_SHARE_LIMIT * statistics.frames
    assert machines <= MACHINES_SHARE_LIMIT * frames
    assert typical_s < WIRE_S + HELD_UP_S


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_a_million_frames_over_the_line_leak_no_memory_on_either_side(tmp_path: Path) -> None:
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
