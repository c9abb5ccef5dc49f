"""The seed of the scene that a scene choice gives."""

from __future__ import annotations

from pathlib import Path

import pytest

from procedures.runs.request import CaseProcedure, RunRequest, SceneChoice


def test_a_built_in_scene_uses_the_requested_seed() -> None:
    assert SceneChoice("mini", seed=7).scene_seed == 7


@pytest.mark.parametrize(("name", "text"), [("scene.toml", "seed = 4\n"), ("scene.json", '{"seed": 4}')])
def test_a_scene_file_brings_its_own_seed(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert SceneChoice(str(tmp_path / name)).scene_seed == 4


@pytest.mark.parametrize("text", ["seed = ", "seed = [1]\n"])
def test_an_invalid_scene_file_gives_seed_zero(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert SceneChoice(str(tmp_path / "scene.toml")).scene_seed == 0


def test_theatre_and_patient_are_made_for_the_chosen_arm() -> None:
    assert SceneChoice("mini", arm="ur5e").arguments()[-2:] == ["--arm", "ur5e"]
    assert "--arm" not in SceneChoice("mini").arguments()


def test_a_case_on_configured_endpoints_has_no_seed(tmp_path: Path) -> None:
    assert RunRequest(procedure=CaseProcedure()).seed == 0
    assert RunRequest(procedure=CaseProcedure(), config=tmp_path / "theatre.toml").seed is None
