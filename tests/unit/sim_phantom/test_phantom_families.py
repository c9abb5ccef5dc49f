"""Phantom families hold what they promise, and the families for judging are not those for tuning."""

from __future__ import annotations

import json
import tomllib
from itertools import combinations
from math import dist
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.adhesive_marker import THICKNESS_MM
from ronna_hw.x_frame import CLOSE_SPHERE_CENTRES_MM, SPHERE_CENTRES_MM
from sim.errors import BAD_SCENE
from sim.phantom.case import plan_toml, write_case
from sim.phantom.families.catalogue import FAMILIES, PAIR_DISTANCE_MM, PROTOCOLS, Purpose
from sim.phantom.families.family_scan import CLEARANCE_MM, family_scan
from sim.phantom.head.adhesive import skin_rings
from sim.phantom.head.obstacles import XFRAME, XFRAME_CLOSE
from sim.phantom.head.shapes import Ball, Rod
from sim.phantom.scan import Scan, adhesive_scan, plain_scan
from sim.world.noise import noise
from sim.world.rigid import Point
from sim.world.scene.head import ADHESIVES_APART_MM, stick_adhesives
from sim.world.scene.model import Scene


def centres(scan: Scan) -> np.ndarray:
    return np.array([fiducial.centre_ct_mm for fiducial in scan.scene.head.fiducials])


def deepest(scan: Scan, point: Point) -> float:
    """How deep a point lies in anything that is neither headrest nor marker."""
    x, y, z = (np.array([value], dtype=np.float32) for value in point)
    return max(float(shape.depth(x, y, z)[0]) for shape in scan.anatomy.surroundings)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("seed", range(3))
def test_a_drawn_family_has_its_markers_and_nothing_intersects_its_spheres(name: str, seed: int) -> None:
    scan = family_scan(name, "poor", seed=seed)
    assert len(scan.anatomy.markers) == FAMILIES[name].markers
    assert scan.scene.ct == PROTOCOLS["poor"]
    assert scan.truth["purpose"] == FAMILIES[name].purpose
    if FAMILIES[name].bandage_mm is None:
        assert all(deepest(scan, point) < -6.0 for point in centres(scan).tolist())
    spacing = np.linalg.norm(centres(scan)[:, None] - centres(scan)[None], axis=2)
    assert spacing[spacing > 0].min() > (PAIR_DISTANCE_MM - 0.01 if FAMILIES[name].pairs else 25.0)


def test_nine_families_are_for_tuning_and_sixteen_for_judging() -> None:
    purposes = [family.purpose for family in FAMILIES.values()]
    assert purposes.count(Purpose.TUNING) == 9
    assert purposes.count(Purpose.JUDGING) == 16


def test_bare_spheres_have_no_post_and_no_other_shape() -> None:
    scan = family_scan("bare", "good", seed=1)
    for marker in scan.anatomy.markers:
        (ball,) = marker.shapes
        assert isinstance(ball, Ball)
        assert (marker.post, ball.radius) == ("none", marker.fiducial.radius_mm)


def test_the_crowded_family_has_close_pairs_and_look_alikes_of_the_same_polymer() -> None:
    scan = family_scan("crowded", "good", seed=1)
    spacing = np.linalg.norm(centres(scan)[:, None] - centres(scan)[None], axis=2)
    assert (np.abs(spacing - 14.0) < 1e-3).sum() == 2 * 2
    balls = [shape for shape in scan.anatomy.surroundings if isinstance(shape, Ball) and shape.radius == 8.0]
    rods = [shape for shape in scan.anatomy.surroundings if isinstance(shape, Rod) and shape.radius == 6.0]
    assert (len(balls), len(rods)) == (4, 4)
    assert len(scan.truth["distractors_mm"]) == 8
    assert all(100.0 <= shape.hu <= 150.0 for shape in [*balls, *rods])


@pytest.mark.parametrize("seed", range(4))
def test_the_edge_family_marks_exactly_the_spheres_cut_by_the_field(seed: int) -> None:
    scan = family_scan("edge", "usual", seed=seed)
    grid = scan.grid
    high = np.array([grid.x_mm[-1] + 0.3, grid.z_mm[-1] + 0.625])
    room = (high - centres(scan)[:, [0, 2]]).min(axis=1)
    cut = [number for number, marks in scan.marks.items() if "surface_in_field" in marks]
    assert cut
    assert sorted(cut) == sorted(int(k) + 1 for k in np.flatnonzero(room < 5.75))
    assert (room > 1.4).all()


@pytest.mark.parametrize("family", ["dressing", "soaked"])
def test_a_wet_bandage_states_the_buried_share_of_each_sphere(family: str) -> None:
    shares = [
        marks["buried_share"]
        for seed in range(6)
        for marks in family_scan(family, "good", seed=seed).marks.values()
    ]
    assert len(shares) == 6 * 7
    assert max(shares) > 0.4
    assert min(shares) == 0.0


def test_the_x_shaped_frame_keeps_its_distances_and_its_spheres_lie_outside_the_head() -> None:
    scan = family_scan("narrow", "good", seed=2, fiducials=XFRAME)
    wanted, found = np.array(SPHERE_CENTRES_MM), centres(scan)
    for points in (wanted, found):
        assert points.shape == (4, 3)
    distance = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (wanted, found)]
    np.testing.assert_allclose(distance[0], distance[1], atol=1e-4)
    inside = (found - scan.scene.head.centre_ct_mm) / np.array(scan.scene.head.semi_axes_mm)
    assert (np.linalg.norm(inside, axis=1) > 1.1).all()


def test_additional_markers_clear_the_bars_of_the_close_frame() -> None:
    scan = family_scan("plain", "good", seed=2, markers=8, fiducials=XFRAME_CLOSE)
    found = centres(scan)
    apart = np.linalg.norm(found[:, None] - found[None], axis=2)
    frame = np.array(CLOSE_SPHERE_CENTRES_MM)
    np.testing.assert_allclose(apart[:4, :4], np.linalg.norm(frame[:, None] - frame[None], axis=2), atol=1e-4)
    along = np.linspace(found[[0, 1]], found[[2, 3]], 50).reshape(-1, 3)
    assert np.linalg.norm(found[4:, None] - along[None], axis=2).min() > CLEARANCE_MM
    assert len(scan.anatomy.markers) == 8


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "martian"}, "unknown family"),
        ({"protocol": "perfect"}, "unknown protocol"),
        ({"markers": 40}, "carries 1 to 8"),
        ({"name": "crowded", "markers": 3}, "carries 4 to 8"),
        ({"markers": 3, "fiducials": XFRAME}, "4 to 8 markers"),
    ],
)
def test_an_impossible_family_is_refused(arguments: dict[str, object], words: str) -> None:
    with raises(BAD_SCENE, match=words):
        family_scan(**({"name": "plain", "protocol": "good"} | arguments))  # type: ignore[arg-type]


def test_the_truth_of_a_family_is_written_with_the_series(coarse_scene: Scene, tmp_path: Path) -> None:
    scan = family_scan("bandage", "poor", seed=3)
    coarse = Scan(
        scan.scene.model_copy(update={"ct": coarse_scene.ct}),
        scan.grid.__class__(scan.grid.origin_mm, 2.0, 4.0, 128, 128, 52),
        scan.anatomy,
        truth=scan.truth,
        marks=scan.marks,
    )
    truth = json.loads(write_case(coarse.scene, tmp_path, scan=coarse).truth.read_text())
    assert (truth["family"], truth["purpose"], truth["protocol"]) == ("bandage", "judging", "poor")
    assert all("buried_share" in fiducial for fiducial in truth["fiducials"])
    assert truth["scene"] == "bandage-poor"


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
