"""Adhesive rings on a phantom: on the skin, apart, alone in their scan, and in its plan and truth."""

from __future__ import annotations

import tomllib
from itertools import combinations
from math import dist

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.adhesive_marker import THICKNESS_MM
from sim.errors import BAD_SCENE
from sim.phantom.case import plan_toml
from sim.phantom.head.adhesive import skin_rings
from sim.phantom.scan import adhesive_scan, plain_scan
from sim.world.noise import noise
from sim.world.scene.head import ADHESIVES_APART_MM, stick_adhesives
from sim.world.scene.model import Scene


@pytest.fixture
def scene(coarse_scene: Scene) -> Scene:
    head = stick_adhesives(coarse_scene.head, 8, noise(3, "adhesive sites", 0))
    return Scene.model_validate(coarse_scene.model_copy(update={"head": head}).model_dump(by_alias=True))


def test_rings_are_apart_and_their_matter_is_around_the_hole_and_on_the_skin(scene: Scene) -> None:
    for one, other in combinations(scene.head.adhesives, 2):
        assert dist(one.centre_ct_mm, other.centre_ct_mm) > ADHESIVES_APART_MM
    for one, ring in zip(scene.head.adhesives, skin_rings(scene), strict=True):
        centre, normal = np.array(one.centre_ct_mm), np.array(one.normal_ct)
        aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        aside /= np.linalg.norm(aside)
        depths = [
            float(ring.depth(*(np.array([value], dtype=np.float32) for value in place))[0])
            for place in (centre, centre + 5.0 * aside, centre - 5.0 * aside, centre + THICKNESS_MM * normal)
        ]
        assert depths[0] < 0.0 < min(depths[1:3])
        assert depths[3] < 0.0
        assert depths[1] == pytest.approx(0.5 * THICKNESS_MM, abs=0.25)


def test_a_scan_of_adhesive_markers_has_no_spheres_and_its_plan_says_so(scene: Scene) -> None:
    scan = adhesive_scan(scene)
    assert scan.anatomy.markers == ()
    plan = tomllib.loads(plan_toml(scan, "1.2"))
    assert (plan["fiducials"], plan["implanted"]) == ("adhesive", 8)


def test_rings_of_a_scene_are_scanned_beside_its_spheres(scene: Scene) -> None:
    scan = plain_scan(scene)
    assert len(scan.anatomy.markers) == len(scene.head.fiducials)
    assert set(skin_rings(scene)) <= set(scan.anatomy.surroundings)
    assert tomllib.loads(plan_toml(scan, "1.2"))["fiducials"] == "free"


def test_more_rings_than_fit_are_refused(coarse_scene: Scene) -> None:
    with raises(BAD_SCENE, match="60 adhesive markers do not fit"):
        stick_adhesives(coarse_scene.head, 60, noise(3, "adhesive sites", 0))
