"""`ronna-sim scene` prints a starting point for a custom scene file."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.marker_template import read_marker_template
from sim.errors import BAD_SCENE
from sim.phantom.case import plan_toml
from sim.phantom.scan import plain_scan
from sim.theatre.command import scene
from sim.world.scene.head import JIG_MM
from sim.world.scene.model import read_scene
from sim.world.scene.named_scenes import draw_scene


@pytest.mark.parametrize("name", ["default", "mini", "bench"])
def test_a_printed_scene_is_read_back_unchanged(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene(scene=name, seed=4)
    file = tmp_path / "scene.toml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    assert read_scene(file) == draw_scene(name, seed=4)


TEMPLATE = """
schema = 1
[[markers]]
centre_mm = [68.54461, -61.150906, 883.888579]
post = [0.769291, -0.153625, 0.620154]
[[markers]]
centre_mm = [-46.188572, -47.806141, 901.300026]
post = [-0.600498, -0.049932, 0.798066]
[[markers]]
centre_mm = [6.028415, -152.239061, 803.323291]
post = [0.037587, -0.99527, -0.089584]
"""


def test_a_template_places_the_spheres_and_enters_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    template, file = tmp_path / "template.toml", tmp_path / "scene.toml"
    template.write_text(TEMPLATE)
    scene(scene="mini", seed=4, template=template)
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    head = read_scene(file).head
    wanted = np.array(read_marker_template(template).centres_mm)
    centres = np.array([one.centre_ct_mm for one in head.fiducials])
    assert 0.0 < np.abs(centres - wanted).max() < 5.0 * JIG_MM
    assert head.template_mm == read_marker_template(template).centres_mm
    planned = tomllib.loads(plan_toml(plain_scan(read_scene(file)), "1.2.3"))
    assert planned["template_mm"] == wanted.tolist()


def test_a_template_of_another_head_is_refused(tmp_path: Path) -> None:
    template = tmp_path / "template.toml"
    template.write_text(TEMPLATE.replace("883.888579", "783.888579"))
    with raises(BAD_SCENE, match="marker 1 of the template is not on this head"):
        scene(scene="mini", seed=4, template=template)
    with raises(BAD_SCENE, match="fixes the number of markers"):
        scene(scene="mini", seed=4, markers=3, template=template)
