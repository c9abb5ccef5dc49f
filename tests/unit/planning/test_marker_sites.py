"""Markers are placed to serve the planned targets, and their claimed errors hold in random trials."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from prepared_results import checked_plan

from procedures.cli.planning_inputs import read_assumed_pose
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.errors import HEAD_UNREADABLE, NO_MARKER_SITES, NO_TEMPLATE, WRONG_SERIES
from procedures.planning.head_in_ct import HeadEllipsoid, fit_head, sample_head
from procedures.planning.marker_sites import (
    APART_MM,
    CLEAR_OF_PATH_MM,
    CRANIUM,
    STANDOFF_MM,
    list_sites,
    propose_further,
    propose_markers,
    propose_template,
    write_template,
)
from procedures.planning.scene_head import read_scene_head
from procedures.registration.error_theory import tre_principal_axes_mm
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.surface.regions import HeadAxes
from procedures.reporting.pictures import marker_picture
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.pose import Pose
from ronna_hw.marker_template import BAD_TEMPLATE, MarkerTemplate, read_marker_template

HEAD = HeadEllipsoid(centre_mm=(3.0, -40.0, 810.0), semi_axes_mm=(75.0, 95.0, 90.0))
TRAJECTORIES = (
    Trajectory("T1", (30.0, -90.0, 880.0), (20.0, -45.0, 820.0)),
    Trajectory("T2", (-25.0, -80.0, 885.0), (-10.0, -50.0, 800.0)),
)
TRIALS = 20_000
ERROR_MM = 0.3


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_markers_keep_apart_clear_of_the_paths_and_serve_every_target_better_than_by_chance(
    count: int,
) -> None:
    found = propose_markers(HEAD, TRAJECTORIES, count, ERROR_MM)
    centres = np.array(found.centres_mm)
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(count, 1)]
    assert apart.min() >= APART_MM - 0.01
    for one in TRAJECTORIES:
        away = centres - one.target_mm
        aside = away - np.outer(away @ one.axis_ct, one.axis_ct)
        assert np.linalg.norm(aside, axis=1).min() >= CLEAR_OF_PATH_MM - 0.01
    assert all(target.expected_mm < target.usual_mm for target in found.targets)


def test_one_more_marker_helps_every_target_more_than_a_proposed_one_that_is_elsewhere() -> None:
    every = np.array(propose_markers(HEAD, TRAJECTORIES, 5, ERROR_MM).centres_mm)
    present = every[:4]
    found = propose_further(HEAD, TRAJECTORIES, present, ERROR_MM)
    assert np.linalg.norm(present - found.centre_mm, axis=1).min() >= APART_MM - 0.01
    assert [name for name, _, _ in found.targets] == ["T1", "T2"]
    assert all(after < now for _, now, after in found.targets)
    fifth = tre_principal_axes_mm(np.array([one.target_mm for one in TRAJECTORIES]), every, ERROR_MM)
    assert sum(after**2 for _, _, after in found.targets) <= np.square(fifth).sum() + 1e-6


def test_the_claimed_errors_match_random_trials() -> None:
    found = propose_markers(HEAD, TRAJECTORIES, 5, ERROR_MM)
    centres, random = np.array(found.centres_mm), np.random.default_rng(0)
    seen = centres + random.normal(0.0, ERROR_MM / np.sqrt(3.0), (TRIALS, 5, 3))
    fit = fit_rigid(np.broadcast_to(centres, seen.shape), seen)
    for one, claimed in zip(TRAJECTORIES, found.targets, strict=True):
        error = fit.rotation @ np.array(one.target_mm) + fit.translation_mm - one.target_mm
        rms_mm = np.sqrt(np.mean(np.square(error).sum(axis=-1)))
        assert rms_mm == pytest.approx(claimed.expected_mm, rel=0.03)


def test_a_head_without_room_for_the_markers_is_refused() -> None:
    small = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(25.0, 25.0, 25.0))
    with raises(NO_MARKER_SITES, match=r"PLAN-021.*8 markers"):
        propose_markers(small, (Trajectory("T1", (0.0, -25.0, 25.0), (0.0, 0.0, 0.0)),), 8, ERROR_MM)
    around = np.random.default_rng(0).normal(0.0, 25.0, (200, 3))
    with raises(NO_MARKER_SITES, match=r"PLAN-021.*one more marker"):
        propose_further(small, TRAJECTORIES, around, ERROR_MM)


def test_the_marker_picture_is_a_png() -> None:
    found = propose_markers(HEAD, TRAJECTORIES, 4, ERROR_MM)
    assert marker_picture(found, HEAD, TRAJECTORIES).startswith(b"\x89PNG")


@pytest.mark.parametrize(("markers", "margin_mm"), [(3, 30.0), (4, 10.0)])
def test_all_distances_differ_by_the_margin_and_the_markers_are_on_the_skin(
    markers: int, margin_mm: float
) -> None:
    found = propose_template(HEAD, markers, margin_mm)
    assert len(found.markers) == markers
    assert found.least_difference_mm >= margin_mm
    assert found.distances_mm[0] >= APART_MM
    for marker in found.markers:
        foot = np.array(marker.centre_mm) - STANDOFF_MM * np.array(marker.post) - HEAD.centre_mm
        assert np.linalg.norm(foot / np.array(HEAD.semi_axes_mm)) == pytest.approx(1.0, abs=1e-5)
        assert (foot[2] - foot[1]) > 0.0  # between forehead and vertex


def test_a_smaller_margin_never_costs_accuracy() -> None:
    def error(margin_mm: float) -> float:
        points = np.array(propose_template(HEAD, 4, margin_mm).centres_mm)
        return float(tre_principal_axes_mm(np.array([HEAD.centre_mm]), points, 1.0)[0])

    assert error(2.0) <= error(8.0) <= error(14.0)


def test_a_margin_no_head_has_room_for_is_refused_with_the_largest_possible_one() -> None:
    with raises(NO_TEMPLATE, match=r"PLAN-015.*40 mm.*at most .* mm"):
        propose_template(HEAD, 4, 40.0)


def test_the_skin_is_taken_from_the_ct_and_not_from_the_ellipsoid() -> None:
    """A head that is flat on one side: the ellipsoid around it stands off there."""
    radius_mm, flat_at_mm, voxel_mm = 88.0, 30.0, 4.0
    axis = np.arange(-118.0, 119.0, voxel_mm)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    voxels = np.where((x**2 + y**2 + z**2 < radius_mm**2) & (x < flat_at_mm), 40, -1000).astype(np.int16)
    geometry = VoxelGeometry(
        voxels.shape, np.full(3, axis[0]), np.eye(3)[:, ::-1].copy(), np.full(3, voxel_mm)
    )
    volume = Volume(voxels, geometry, "1.2.3", "1.2.4")
    found = propose_template(fit_head(volume), 3, 10.0, volume=volume)
    feet = [np.array(one.centre_mm) - STANDOFF_MM * np.array(one.post) for one in found.markers]
    for foot in feet:
        assert min(abs(np.linalg.norm(foot) - radius_mm), abs(foot[0] - flat_at_mm)) < voxel_mm
    assert max(foot[0] for foot in feet) < flat_at_mm + voxel_mm


def test_markers_are_on_the_cranium_that_the_ct_shows() -> None:
    """A head so high that the sites between forehead and vertex reach down to its eyes."""
    axes_mm, voxel_mm = np.array([75.0, 95.0, 144.0]), 4.0
    axis = np.arange(-178.0, 179.0, voxel_mm)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    inside = ((np.stack([x, y, z], axis=-1) / axes_mm) ** 2).sum(axis=-1) < 1.0
    geometry = VoxelGeometry(x.shape, np.full(3, axis[0]), np.eye(3)[:, ::-1].copy(), np.full(3, voxel_mm))
    volume = Volume(np.where(inside, 40, -1000).astype(np.int16), geometry, "1.2.3", "1.2.4")
    head, by_volume = fit_head(volume), HeadAxes.of_points(sample_head(volume)[0])
    random = np.random.default_rng(0)
    assert {"eyes", "nose"} <= set(by_volume.name_parts(list_sites(head, volume, random)[0]))
    found = propose_markers(head, TRAJECTORIES, 5, ERROR_MM, volume=volume)
    assert set(by_volume.name_parts(np.array(found.centres_mm))) <= set(CRANIUM)
    present = np.array(found.centres_mm[:4])
    further = propose_further(head, TRAJECTORIES, present, ERROR_MM, volume=volume)
    assert set(by_volume.name_parts(np.array([further.centre_mm]))) <= set(CRANIUM)


def test_objects_on_the_skin_are_not_taken_for_skin() -> None:
    radius_mm, voxel_mm = 88.0, 4.0
    axis = np.arange(-129.0, 130.0, voxel_mm)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    points = np.stack([x, y, z], axis=-1)
    geometry = VoxelGeometry(x.shape, np.full(3, axis[0]), np.eye(3)[:, ::-1].copy(), np.full(3, voxel_mm))

    def on(solid: np.ndarray) -> MarkerTemplate:
        volume = Volume(np.where(solid, 40, -1000).astype(np.int16), geometry, "1.2.3", "1.2.4")
        return propose_template(fit_head(volume), 3, 10.0, volume=volume)

    head = np.linalg.norm(points, axis=-1) < radius_mm
    standing = [np.linalg.norm(points - np.array(one.centre_mm), axis=-1) < 8.0 for one in on(head).markers]
    for marker in on(np.any([head, *standing], axis=0)).markers:
        foot = np.array(marker.centre_mm) - STANDOFF_MM * np.array(marker.post)
        assert abs(np.linalg.norm(foot) - radius_mm) < voxel_mm


def test_a_template_survives_writing_and_reading(tmp_path: Path) -> None:
    template = propose_template(HEAD, 4, 8.0)
    write_template(tmp_path / "t.toml", template)
    assert read_marker_template(tmp_path / "t.toml") == template


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("schema = 1\n", "markers"),
        ("schema = 2\nmarkers = []\n", "schema"),
        ("{", "not TOML"),
        (
            "schema = 1\n" + "[[markers]]\ncentre_mm = [0.0, 0.0, 0.0]\npost = [0.0, 0.0, 2.0]\n" * 3,
            "not a unit vector: its length is 2.000",
        ),
        (
            "schema = 1\n" + "[[markers]]\ncentre_mm = [0.0, 0.0, 0.0]\npost = [0.0, 0.0, 1.0]\n" * 3,
            "0.0 mm apart, limit 15 mm",
        ),
    ],
)
def test_a_file_that_is_not_a_template_is_refused_with_the_reason(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "t.toml"
    path.write_text(text)
    with raises(BAD_TEMPLATE, match=said) as refused:
        read_marker_template(path)
    assert refused.value.code == "TPL-001"


@pytest.mark.parametrize(
    ("text", "said"),
    [("seed = 1\n", "head"), ("[head]\ncentre_ct_mm = [0.0, 0.0, 0.0]\n", "semi_axes_mm"), ("[", "not TOML")],
)
def test_a_scene_without_a_head_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with raises(HEAD_UNREADABLE, match=said):
        read_scene_head(path)


def test_a_scene_file_tells_where_the_robot_has_the_ct(tmp_path: Path) -> None:
    path, head = tmp_path / "scene.json", {"centre_ct_mm": [0.0] * 3, "semi_axes_mm": [80.0] * 3}
    plan, pose = (
        checked_plan().plan,
        {"translation_mm": [900.0, 0.0, 20.0], "quaternion_wxyz": [0, 0, 0, 1]},
    )
    path.write_text(json.dumps({"head": {**head, "robot_from_ct": pose}}))
    assert Pose.from_kuka(*read_assumed_pose(path, plan)).position_mm == (900.0, 0.0, 20.0)
    assert read_assumed_pose(path, plan)[3:] == pytest.approx((180.0, 0.0, 0.0))
    path.write_text(json.dumps({"head": head}))
    with raises(HEAD_UNREADABLE, match=r"no head\.robot_from_ct"):
        read_assumed_pose(path, plan)
    path.write_text(json.dumps({"head": {**head, "targets": [{"target_ct_mm": [0.0, 0.0, 1.0]}]}}))
    with raises(WRONG_SERIES, match=r"PLAN-003: scene\.json"):
        read_assumed_pose(path, plan)


def test_the_distances_of_a_template_are_listed_in_ascending_order() -> None:
    template = propose_template(HEAD, 3, 10.0)
    expected = sorted(
        float(np.linalg.norm(np.subtract(a, b))) for a, b in combinations(template.centres_mm, 2)
    )
    assert template.distances_mm == pytest.approx(expected)
