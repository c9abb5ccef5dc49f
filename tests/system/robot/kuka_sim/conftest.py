"""Robot controllers as processes of their own, for plain UDP and TCP clients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from kuka_clients import Cell
from shared_controller import SharedController

from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World


@pytest.fixture
def cell() -> Iterator[Callable[..., Cell]]:
    with ExitStack() as stack:
        yield lambda *options, world=None: Cell(stack, *options, world=world)


@pytest.fixture
def lock_step_world() -> Iterator[World]:
    world = World.create(draw_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


@pytest.fixture(scope="module")
def only_controller() -> Iterator[SharedController]:
    with ExitStack() as stack:
        yield SharedController(stack)


@pytest.fixture
def shared(only_controller: SharedController) -> SharedController:
    only_controller.begin()
    return only_controller
