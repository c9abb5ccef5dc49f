"""A unit on the bench and a host that sends it command lines."""

from __future__ import annotations

from typing import Any

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.model import SPECTRA, UnitModel
from sim.polaris.unit.ports import WiredPorts
from sim.world.scene.model import Scene, TrackerTool
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

POINTER = TrackerTool(
    name="pointer",
    part_number="8700340",
    markers_mm=((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
)
BENCH = draw_scene("bench")
EVERY_FRAME = 2  # illuminator rate of 60 Hz: each count is a new measurement


@pytest.fixture
def make_bench() -> MakeBench:
    """Make a bench from a scene; requests advance its clock, so every frame is new."""

    def make(
        scene: Scene | None = None,
        *,
        paced: bool = False,
        model: UnitModel = SPECTRA,
        wired: WiredPorts | None = None,
        **behaviour: Any,
    ) -> Bench:
        world = World.create(scene or BENCH, paced=paced)
        behaviour.setdefault("saved_illuminator_rate", EVERY_FRAME)
        unit = SimulatedUnit(world, model, UnitBehaviour(**behaviour), wired)
        return Bench(world, unit, CommandInterpreter(unit))

    return make


@pytest.fixture
def pointer() -> TrackerTool:
    """A tool that is not the reference frame."""
    return POINTER


@pytest.fixture
def tracked(bench: Bench, pointer: TrackerTool) -> Bench:
    """A unit that tracks the pointer."""
    return bench.track(pointer)


@pytest.fixture
def bench(make_bench: MakeBench) -> Bench:
    """An initialised unit on the bench."""
    return make_bench().ready()
