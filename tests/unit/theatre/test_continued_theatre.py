"""What a continued theatre accepts: the scene and seed of the world that was left, or none."""

from __future__ import annotations

from pathlib import Path

import pytest
from user_commands import in_this_process, one_error

from ronna_hw.errors import EXIT_USAGE
from sim.cli import app as ronna_sim
from sim.world.scene.named_scenes import named_scene
from sim.world.truth import SCENE_FILE

REFUSED_LATER = ("--set", "robot.tea=1")  # so that no theatre is started


@pytest.fixture
def left(tmp_path: Path) -> Path:
    """The folder of a theatre that was left."""
    (tmp_path / SCENE_FILE).write_text(named_scene("mini", seed=4).model_dump_json(by_alias=True))
    return tmp_path


def _refusal(folder: Path, *options: str) -> str:
    done = in_this_process(ronna_sim, "theatre", *options, "--out", folder, "--continue", *REFUSED_LATER)
    assert done.returncode == EXIT_USAGE
    return " ".join(one_error(done.stderr))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scene", "default", "--seed", "4"), "cannot be changed; expected mini, got default"),
        (("--scene", "mini", "--seed", "5"), "cannot be changed; expected 4, got 5"),
        (("--seed", "5"), "the seed of the world left in"),
        (("--markers", "6"), "the markers of the world left in"),
        (("--targets", "4"), "the targets of the world left in"),
    ],
)
def test_a_theatre_is_not_continued_with_another_scene_seed_or_head(
    left: Path, options: tuple[str, ...], said: str
) -> None:
    assert said in _refusal(left, *options)


@pytest.mark.parametrize(
    "options", [(), ("--scene", "mini", "--seed", "4"), ("--seed", "4"), ("--markers", "3")]
)
def test_a_theatre_is_continued_with_its_own_scene_and_seed_or_without_any(
    left: Path, options: tuple[str, ...]
) -> None:
    assert "unknown parameter 'tea'" in _refusal(left, *options)
