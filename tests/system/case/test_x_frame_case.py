"""A whole case with the x-shaped frame: the tracker sees it as a tool, or its spheres as strays."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w
from user_commands import Commands

from ronna_hw.x_frame import NAME
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
LIMIT_MM = 1.0  # of the one target: the mini scene's CT is coarse


def known_as_strays(folder: Path) -> tuple[str, ...]:
    """The scene in a file, for a tracker without the frame's definition."""
    scene, file = draw_scene("mini", seed=3, x_frame=True), folder / "scene.toml"
    tools = [
        one.model_dump(mode="json", exclude_none=True) for one in scene.tracker.tools if one.name != NAME
    ]
    assert len(tools) == len(scene.tracker.tools) - 1
    content = scene.model_dump(mode="json", by_alias=True, exclude_none=True)
    content["tracker"]["tools"] = tools
    file.write_text(tomli_w.dumps(content))
    return ("--scene", str(file))


@pytest.mark.parametrize("as_tool", [True, False], ids=["as a tool", "as strays"])
def test_a_case_with_the_x_shaped_frame_reaches_its_target(
    commands: Commands, tmp_path: Path, as_tool: bool
) -> None:
    named = ("--scene", "mini", "--seed", "3", "--fiducials", "xframe")
    scene = named if as_tool else known_as_strays(tmp_path)
    options = (*scene, "--out", str(tmp_path / "runs"), "--json")
    ran = commands.run("ronna-procedure", "run", "--sim", *options, timeout_s=200)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert outcome["ct"]["found"] == 4
    assert outcome["registration"]["n"] == 4
    assert outcome["max_application_error_mm"] < LIMIT_MM
