"""`ronna-sim scene` prints what a scene file of one's own begins with."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim.theatre.scene.command import scene
from sim.theatre.scene.model import read_scene
from sim.theatre.scene.named_scenes import named_scene


@pytest.mark.parametrize("name", ["default", "mini", "bench"])
def test_a_scene_that_was_printed_is_the_same_when_read_again(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene(scene=name, seed=4)
    file = tmp_path / "scene.toml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    assert read_scene(file) == named_scene(name, seed=4)
