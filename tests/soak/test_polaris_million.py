"""A million disturbed replies, and a million frames in memory that does not grow."""

from __future__ import annotations

import gc
import resource
from pathlib import Path

import pytest
from polaris_mutations import Campaign
from polaris_unit_in_process import StillClock, UnitInProcess, tracker_on

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

MUTATED = 1_000_000
SHARES = 10  # of the million, each with a seed of its own, so that several workers take part
FRAMES = 1_000_000


@pytest.mark.hazard(16)
@pytest.mark.parametrize("seed", range(100, 100 + SHARES))
def test_none_of_a_million_disturbed_replies_is_accepted(seed: int) -> None:
    campaign = Campaign(seed, reply="BX" if seed % 2 else "TX")
    campaign.run(MUTATED // SHARES)
    assert campaign.mutated >= MUTATED // SHARES


def test_a_million_frames_leak_no_memory() -> None:
    unit, clock = UnitInProcess(baud=None), StillClock()
    unit.strays = [(40.0 * k, 0.0, -1500.0) for k in range(8)]
    tracker = tracker_on(unit, clock, "tcp://127.0.0.1:1")
    tracker.connect()
    tracker.configure()
    tracker.activate()

    def read(frames: int) -> None:
        for _ in range(frames):
            clock.time_s += 1 / 60
            tracker.read_frame()
            unit.commands.clear()

    read(FRAMES // 10)  # a minute of the clock's fit is kept: it is full by now
    gc.collect()
    before = resident_bytes()
    read(FRAMES - FRAMES // 10)
    gc.collect()
    assert resident_bytes() - before < 2_000_000
    assert tracker.statistics.frames == FRAMES


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()
