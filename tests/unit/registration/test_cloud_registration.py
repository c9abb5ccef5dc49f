"""Clouds without correspondences: registered from any pose, or refused where the shape leaves it open."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import register_clouds
from procedures.registration.errors import (
    NOT_CONVERGED,
    SYMMETRIC_CLOUD,
    TOO_FEW_POINTS,
    UNSOUND_REGISTRATION,
    BadParameter,
    CollinearPoints,
)


def head(count: int, random: np.random.Generator) -> np.ndarray:
    """Points on a head with a nose and one ear, so that no two poses look alike."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lengths = 1.0 + 0.6 * np.exp(-8 * (1 - direction @ [0.0, 0.8, 0.6]))
    lengths += 0.4 * np.exp(-8 * (1 - direction @ [1.0, 0.0, 0.0]))
    return direction * [75.0, 95.0, 60.0] * lengths[:, None]


def apart(found: RigidTransform, truth: RigidTransform, points: np.ndarray) -> float:
    """Largest distance between the points under the two transforms, mm."""
    return float(np.linalg.norm(found.apply(points) - truth.apply(points), axis=1).max())


def test_a_cloud_is_registered_from_any_pose(random, any_pose):
    for _ in range(5):
        points, truth = head(500, random), any_pose(random)
        found = register_clouds(points, random.permutation(truth.apply(points)))
        assert apart(found.transform, truth, points) < 1e-6
        assert found.residual_mm < 1e-6


def test_two_samplings_of_one_surface_agree_within_their_spacing(random, any_pose):
    truth = any_pose(random)
    image, physical = head(900, random), truth.apply(head(1200, random))
    found = register_clouds(image, physical)
    errors_mm = np.linalg.norm(found.transform.apply(image) - truth.apply(image), axis=1)
    assert np.sqrt(np.mean(errors_mm**2)) < found.residual_mm < 6.0


def test_a_partial_cloud_is_registered_with_a_start_and_an_overlap(random, any_pose):
    points, truth = head(800, random), any_pose(random)
    seen = truth.apply(points[points[:, 2] > -20.0])
    rough = RigidTransform.from_components(
        np.add(truth.translation, [2.0, -1.0, 2.0]), Rotation.from_rotvec([0.02, 0.0, -0.02]) * truth.rotation
    )
    found = register_clouds(points, seen, start=rough, overlap=0.9 * len(seen) / len(points))
    assert apart(found.transform, truth, points) < 0.01


BOX = np.array([[x, y, z] for x in (-60, -20, 20, 60) for y in (-40, 0, 40) for z in (-15, 15)], dtype=float)


@pytest.mark.parametrize("shape", ["box", "cube", "square", "ball"])
def test_a_symmetric_cloud_is_refused(shape, random, any_pose):
    ball = random.normal(size=(1000, 3))
    cloud = {
        "box": BOX,
        "cube": np.array([[x, y, z] for x in (0, 90) for y in (0, 90) for z in (0, 90)], dtype=float),
        "square": np.array([[0, 0, 0], [90, 0, 0], [90, 90, 0], [0, 90, 0]], dtype=float),
        "ball": 80.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True),
    }[shape]
    with raises(SYMMETRIC_CLOUD, match="REG-011"):
        register_clouds(cloud, any_pose(random).apply(cloud))


def test_a_start_resolves_the_symmetry(random, any_pose):
    truth = any_pose(random)
    found = register_clouds(BOX, truth.apply(BOX), start=truth)
    assert apart(found.transform, truth, BOX) < 1e-6


def test_a_mirrored_cloud_is_refused(random, any_pose):
    points = head(500, random)
    with raises(UNSOUND_REGISTRATION, match=r"REG-009.*mirror image"):
        register_clouds(points, any_pose(random).apply(points * [-1.0, 1.0, 1.0]))


def test_two_points_a_line_or_a_repeated_point_fix_no_pose(random):
    points = head(10, random)
    with raises(TOO_FEW_POINTS, match="REG-002"):
        register_clouds(points[:2], points)
    with pytest.raises(CollinearPoints, match="REG-003"):
        register_clouds(points, np.outer(np.arange(10.0), [1.0, 2.0, 3.0]))
    with pytest.raises(CollinearPoints, match="REG-003"):
        register_clouds(np.tile(points[:1], (5, 1)), points)


@pytest.mark.parametrize("overlap", [0.0, -1.0, 1.1, 0.1, float("nan")])
def test_an_impossible_overlap_is_refused(overlap, random):
    with pytest.raises(BadParameter, match="REG-007"):
        register_clouds(head(10, random), head(10, random), overlap=overlap)


def test_several_starts_are_refused(random):
    with pytest.raises(BadParameter, match=r"REG-007.*the start.*2 transforms"):
        register_clouds(head(10, random), head(10, random), start=RigidTransform.identity(2))


def test_a_registration_that_does_not_converge_is_reported(random, any_pose, monkeypatch):
    monkeypatch.setattr("procedures.registration.cloud_registration.MOST_STEPS", 1)
    with raises(NOT_CONVERGED, match="REG-006"):
        register_clouds(head(50, random), any_pose(random).apply(head(60, random)))
