"""A whole case with the x-shaped frame: the tracker sees it as a tool, or its spheres as strays."""

from __future__ import annotations

import json

import pytest
from simulated_case import SimulatedCase

from ronna_hw.x_frame import NAME
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
LIMIT_MM = 1.0  # of the one target: the mini scene's CT is coarse


def without_definition() -> Scene:
    """The scene of a tracker without the frame's definition."""
    scene = draw_scene("mini", seed=3, x_frame=True)
    tools = tuple(one for one in scene.tracker.tools if one.name != NAME)
    assert len(tools) == len(scene.tracker.tools) - 1
    return scene.model_copy(update={"tracker": scene.tracker.model_copy(update={"tools": tools})})


@pytest.mark.parametrize("as_tool", [True, False], ids=["as a tool", "as strays"])
def test_a_case_with_the_x_shaped_frame_reaches_its_target(case: SimulatedCase, as_tool: bool) -> None:
    named = ("--scene", "mini", "--seed", "3", "--fiducials", "xframe")
    ran = case.run(*named) if as_tool else case.run(scene=without_definition())
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert outcome["ct"]["found"] == 4
    assert outcome["registration"]["n"] == 4
    assert outcome["max_application_error_mm"] < LIMIT_MM
