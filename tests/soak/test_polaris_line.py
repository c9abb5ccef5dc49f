"""The tracker's driver on a line in real time, and for a very long time."""

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
class Missed:
    """Frames missed between two readings, and where the time of both went.

    Which frame a reply tells is settled when its request arrives: the reply before counts as well.
    """

    frames: int
    at_s: float
    took_s: float
    driver_used_s: float
    unit_used_s: float
    waited_s: float

    @property
    def held_up(self) -> bool:
        """Whether the machine had something wait that had nothing to wait for."""
        return self.waited_s > HELD_UP_S


class Exchanges:
    """Every reading: the frame it told, how long it took, and how much of that was neither work nor wire.

    Kept as bare numbers: objects by the ten thousand would be looked through by each full garbage collection,
    which then takes as long as a frame.
    """

    def __init__(self) -> None:
        self.counts = array("q")
        self.took_s = array("d")
        self.waited_s = array("d")
        self.driver_used_s = array("d")
        self.unit_used_s = array("d")

    def add(self, count: int, took_s: float, driver_used_s: float, unit_used_s: float) -> None:
        used_s = driver_used_s + unit_used_s
        self.counts.append(count)
        self.took_s.append(took_s)
        self.driver_used_s.append(driver_used_s)
        self.unit_used_s.append(unit_used_s)
        self.waited_s.append(max(0.0, took_s - used_s - WIRE_S))

    def missed(self) -> Iterator[Missed]:
        """Wherever frames were missed, in the order of time."""
        for index, (before, count) in enumerate(pairwise(self.counts)):
            if count > before + 1:
                both = slice(index, index + 2)
                yield Missed(
                    count - before - 1,
                    at_s=sum(self.took_s[:index]),
                    took_s=sum(self.took_s[both]),
                    driver_used_s=sum(self.driver_used_s[both]),
                    unit_used_s=sum(self.unit_used_s[both]),
                    waited_s=sum(self.waited_s[both]),
                )


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "minutes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.soak)]
)
def test_at_230400_baud_no_frame_is_missed(
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
    missed = list(exchanges.missed())
    ours = [one for one in missed if not one.held_up]
    machines = sum(one.frames for one in missed if one.held_up)
    frames = exchanges.counts[-1] - exchanges.counts[0]
    typical_s = median(exchanges.took_s)
    with capsys.disabled():
        print(
            f"\n{frames} frames, {statistics.frames} readings, {statistics.repeated} repeated, "
            f"missed {sum(one.frames for one in ours)}, and {machines} while the machine held something up; "
            f"a reading took {typical_s * 1e3:.1f} ms, {WIRE_S * 1e3:.1f} of them on the wire"
            f"{'' if preferred else '; without real-time priority'}"
        )
    assert frames >= 0.99 * minutes * 60.0 * FRAME_RATE_HZ
    assert ours == []
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
