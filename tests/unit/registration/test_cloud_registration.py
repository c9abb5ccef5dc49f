"""Clouds without correspondences are registered from any pose, or refused: by shape, gravity, body, sight."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import register_clouds
from procedures.registration.errors import (
    BAD_POINTS,
    NOT_CONVERGED,
    SYMMETRIC_CLOUD,
    TOO_FEW_POINTS,
    UNSOUND_REGISTRATION,
    BadParameter,
    CollinearPoints,
)
from procedures.registration.room_prior import MIRROR, MIRRORS, HeadSight, RoomPrior, choose_landmark


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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        *(({"overlap": overlap}, "") for overlap in (0.0, -1.0, 1.1, 0.1, float("nan"))),
        ({"start": RigidTransform.identity(2)}, r".*the start.*2 transforms"),
    ],
)
def test_an_impossible_overlap_and_several_starts_are_refused(options, said, random):
    with pytest.raises(BadParameter, match=f"REG-007{said}"):
        register_clouds(head(10, random), head(10, random), **options)


def test_a_cloud_in_metres_is_refused_beside_one_in_millimetres(random, any_pose):
    with raises(BAD_POINTS, match=r"Are the image points in metres\? Give both in millimetres\."):
        register_clouds(head(50, random) / 1000.0, any_pose(random).apply(head(60, random)))


def test_a_registration_that_does_not_converge_is_reported(random, any_pose, monkeypatch):
    monkeypatch.setattr("procedures.registration.cloud_registration.MOST_STEPS", 1)
    with raises(NOT_CONVERGED, match="REG-006"):
        register_clouds(head(50, random), any_pose(random).apply(head(60, random)))


ANTERIOR = np.array([0.0, -1.0, 0.0])
MIDDLE_MM = np.array([800.0, 0.0, 200.0])
SIGHT = HeadSight(np.zeros(3), np.array([75.0, 95.0, 90.0]), np.array([[800.0, 0.0, 2000.0]]))
PRIOR = RoomPrior(ANTERIOR, (0.0, 60.0), 30.0, SIGHT)
# Flat on the back, the vertex towards the arm: left is the arm's left, superior towards it.
SUPINE = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
ON_TOP_MM = np.add(MIDDLE_MM, (0.0, 0.0, 111.0))


def lying(axis: str, angle_deg: float) -> np.ndarray:
    return np.asarray(Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix() @ SUPINE)


@pytest.mark.parametrize(
    ("axis", "angles_deg", "reason"),
    [
        ("y", [-29.0, 0.0, 60.0, 89.0], ""),  # flat, or raised
        ("y", [-50.0], "turned 50 deg beyond the planned patient position, limit 30 deg"),
        ("y", [100.0], "turned 40 deg"),
        ("y", [180.0], "turned 120 deg"),
        ("x", [25.0, -25.0, 20.0], ""),  # to the side, or with a tilted table
        ("x", [15.0 + 20.0], "turned 35 deg"),
        ("z", [90.0], ""),
        ("z", [180.0], "where the patient's body is"),
    ],
)
def test_a_patient_lies_as_planned_within_the_tolerance_and_not_where_the_arm_stands(
    axis: str, angles_deg: list[float], reason: str
) -> None:
    for angle_deg in angles_deg:
        found = PRIOR.check_position(lying(axis, angle_deg), MIDDLE_MM)
        assert reason in found
        assert bool(found) is bool(reason)


def test_the_tracker_sees_no_sphere_through_the_head() -> None:
    assert PRIOR.objection(SUPINE, MIDDLE_MM, ON_TOP_MM[None]) == ""
    below = MIDDLE_MM - (0.0, 0.0, 111.0)
    assert "hide 1 of the spheres" in PRIOR.objection(SUPINE, MIDDLE_MM, np.array([ON_TOP_MM, below]))


def test_every_mirror_is_a_reflection_of_the_axes() -> None:
    for mirror in MIRRORS:
        assert np.linalg.det(mirror) == pytest.approx(-1.0)
        assert np.abs(mirror).sum(axis=0).tolist() == [1.0, 1.0, 1.0]


def test_no_landmark_is_needed_without_a_mirror_image_that_fits() -> None:
    matched = RigidTransform.from_components(MIDDLE_MM, Rotation.from_matrix(SUPINE))
    assert choose_landmark(matched, [], PRIOR) is None
    upside_down = Rotation.from_matrix(lying("x", 180.0) @ np.diag(-MIRROR))
    assert (
        choose_landmark(matched, [RigidTransform.from_components(MIDDLE_MM, upside_down)], PRIOR) is not None
    )


def test_the_landmark_is_where_the_head_of_the_mirror_image_is_farthest_away() -> None:
    """Spheres in a plane beside the head: mirrored in it, the head lies on the other side of them."""
    matched = RigidTransform.from_components(MIDDLE_MM, Rotation.from_matrix(SUPINE))
    plane_mm, normal = np.add(MIDDLE_MM, (0.0, 80.0, 0.0)), np.array([0.0, 1.0, 0.0])
    reflection = np.eye(3) - 2.0 * np.outer(normal, normal)
    turned = reflection @ SUPINE @ np.diag(MIRROR)
    moved_mm = reflection @ (MIDDLE_MM - plane_mm) + plane_mm
    mirrored = RigidTransform.from_components(moved_mm, Rotation.from_matrix(turned))
    landmark = choose_landmark(matched, [mirrored], PRIOR)
    assert landmark is not None
    assert landmark.name != "back of the head"  # which a patient on the back lies on
    assert landmark.apart_mm == pytest.approx(160.0)
