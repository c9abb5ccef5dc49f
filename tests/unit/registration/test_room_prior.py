"""Poses refused by gravity, the patient's body and the tracker's line of sight; mirror images told apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.room_prior import MIRROR, MIRRORS, HeadSight, RoomPrior, choose_landmark

ANTERIOR = np.array([0.0, -1.0, 0.0])
MIDDLE_MM = np.array([800.0, 0.0, 200.0])
SIGHT = HeadSight(np.zeros(3), np.array([75.0, 95.0, 90.0]), np.array([[800.0, 0.0, 2000.0]]))
PRIOR = RoomPrior(ANTERIOR, (0.0, 60.0), 30.0, SIGHT)
# Flat on the back, the vertex towards the arm: left is the arm's left, superior towards it.
SUPINE = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
ON_TOP_MM = np.add(MIDDLE_MM, (0.0, 0.0, 111.0))


def lying(axis: str, angle_deg: float) -> np.ndarray:
    return np.asarray(Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix() @ SUPINE)


@pytest.mark.parametrize("reclined_deg", [-29.0, 0.0, 60.0, 89.0])
def test_a_patient_lies_flat_or_is_raised_within_the_range(reclined_deg: float) -> None:
    assert PRIOR.check_position(lying("y", reclined_deg), MIDDLE_MM) == ""


@pytest.mark.parametrize(("reclined_deg", "beyond"), [(-50.0, "50"), (100.0, "40"), (180.0, "120")])
def test_a_patient_head_down_or_bent_forward_beyond_it_is_refused(reclined_deg: float, beyond: str) -> None:
    reason = PRIOR.check_position(lying("y", reclined_deg), MIDDLE_MM)
    assert (
        reason == f"the head would be turned {beyond} deg beyond the planned patient position, limit 30 deg"
    )


@pytest.mark.parametrize(("turned_deg", "allowed"), [(25.0, True), (-25.0, True), (35.0, False)])
def test_a_head_may_be_turned_to_the_side_within_the_tolerance(turned_deg: float, allowed: bool) -> None:
    assert (PRIOR.check_position(lying("x", turned_deg), MIDDLE_MM) == "") is allowed


def test_a_table_tilted_by_20_degrees_takes_its_part_of_the_tolerance() -> None:
    assert PRIOR.check_position(lying("x", 20.0), MIDDLE_MM) == ""
    assert "turned 35 deg" in PRIOR.check_position(lying("x", 15.0 + 20.0), MIDDLE_MM)


def test_the_arm_cannot_stand_where_the_body_of_the_patient_is() -> None:
    feet_to_the_arm = lying("z", 180.0)
    assert "where the patient's body is" in PRIOR.check_position(feet_to_the_arm, MIDDLE_MM)
    assert PRIOR.check_position(lying("z", 90.0), MIDDLE_MM) == ""


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
