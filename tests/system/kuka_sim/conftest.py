"""Robot controllers as processes of their own, for plain UDP and TCP clients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from kuka_clients import Cell
from kuka_stage import Stage

from sim.world.scene.named_scenes import named_scene
from sim.world.world import World


@pytest.fixture
def cell() -> Iterator[Callable[..., Cell]]:
    with ExitStack() as stack:
        yield lambda *options, world=None: Cell(stack, *options, world=world)


@pytest.fixture
def lock_step_world() -> Iterator[World]:
    world = World.create(named_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


@pytest.fixture(scope="module")
def the_stage() -> Iterator[Stage]:
    with ExitStack() as stack:
        yield Stage(stack)


@pytest.fixture
def stage(the_stage: Stage) -> Stage:
    the_stage.begin()
    return the_stage
