"""Faults in random order, many at once: the arm never jumps, and the controller can be brought back."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Iterator
from contextlib import ExitStack
from math import degrees

import pytest
from kuka_clients import Cell, EkiClient, RsiClient

from sim.world.faults.robot import ROBOT_FAULTS, TRIPS
from sim.world.nominal_arm import description
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

pytestmark = pytest.mark.soak

ROUNDS = 60
FULL_STEP_DEG = [joint.full_speed_deg_s * 0.004 for joint in description("kr6_r900_sixx").joints]
WORDS = {"INT": ("1", "3"), "NUMBER": ("5", "30", "100")}
NAMES = {"mode": ("T1", "AUT"), "trip": TRIPS}


@pytest.fixture
def world() -> Iterator[World]:
    world = World.create(draw_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


def _storm(generator: random.Random, begin_s: float) -> str:
    """Up to four faults that begin within a fifth of a second."""
    lines = []
    for kind in generator.sample(ROBOT_FAULTS, generator.randint(1, 4)):
        choices = {**WORDS, "NAME": NAMES.get(kind.name, ())}
        words = [generator.choice(choices.get(word, (word,))) for word in kind.phrase.split()]
        lasting = "" if kind.momentary else f" for {generator.uniform(0.02, 0.3):.3f} s"
        moment_s = begin_s + generator.uniform(0.0, 0.2)
        lines.append(f"at {moment_s:.6f} s: robot {' '.join(words)}{lasting}")
    return "\n".join(lines)


def _ride(rsi: RsiClient, world: World) -> None:
    """A move under way in the storm; every telegram is compared with the one before."""
    before_s, before = world.clock.now_s(), [degrees(angle) for angle in world.arm().joints_rad]
    for n in range(250):
        correction_deg = 4.0 * (n / 250) ** 2
        if not rsi.try_cycle((correction_deg, 0.0, 0.0, 0.0, 0.0, 0.0)):
            return
        now, now_s = [degrees(angle) for angle in world.arm().joints_rad], world.clock.now_s()
        cycles = round((now_s - before_s) / 0.004) + 2
        for a, b, full in zip(before, now, FULL_STEP_DEG, strict=True):
            assert abs(b - a) <= cycles * 0.25 * full, world.fault_script()[1]
        # While telegrams are lost the cycles run on: the time is read first, for the arm may be further.
        before_s, before = world.clock.now_s(), [degrees(angle) for angle in world.arm().joints_rad]


def _bring_back(cell: Cell, eki: EkiClient) -> EkiClient:
    while True:
        eki.close()
        eki = cell.project()
        with contextlib.suppress(ConnectionError):  # somebody else held the channel until a moment ago
            eki.state(Mode="EXT", EStop="0", Guard="0")
            break
    eki.command("CANCEL")
    assert eki.command("ACK_ERRORS") == 0
    eki.state(RSI="0", Moving="0")
    cell.rsi.forget()
    cell.start(eki)
    cell.rsi.cycles(10)
    eki.state(RSI="2")
    return eki


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("streams", ["true", "false"])
def test_the_controller_recovers_after_every_storm(world: World, streams: str) -> None:
    generator = random.Random(7)
    with ExitStack() as stack:
        cell = Cell(stack, "--set", f"streams_after_stop={streams}", world=world)
        eki = cell.project()
        for _ in range(ROUNDS):
            world.set_fault_script("")
            eki = _bring_back(cell, eki)
            world.set_fault_script(_storm(generator, world.clock.now_s()))
            _ride(cell.rsi, world)
        assert cell.child.alive
