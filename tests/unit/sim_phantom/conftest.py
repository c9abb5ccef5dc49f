"""Small scenes that are scanned quickly."""

from __future__ import annotations

import pytest

from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene

COARSE = CtProtocol(pixel_mm=2.0, slice_mm=4.0, columns=128, rows=128, slices=52, noise_HU=20.0)


@pytest.fixture(scope="session")
def coarse_scene() -> Scene:
    """The mini scene with a coarse protocol."""
    return draw_scene("mini", seed=3).model_copy(update={"ct": COARSE})


@pytest.fixture
def mini_scene() -> Scene:
    """The mini scene as it is."""
    return draw_scene("mini", seed=3)
