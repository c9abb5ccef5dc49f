"""Correspondence through the x-shaped frame: points outside the frame are left unmatched on either side."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import MatchStatus, Prior, find_layout, match_by_template
from procedures.registration.errors import BAD_POINTS, LayoutNotFound
from ronna_hw.x_frame import SPHERE_CENTRES_MM

FRAME = np.array(SPHERE_CENTRES_MM)
SIGMAS = {"sigma_image_mm": 0.17, "sigma_physical_mm": 0.56}


def test_the_frame_is_paired_among_free_spheres_and_strays(random, any_pose, ball):
    in_ct, in_room = any_pose(random), any_pose(random)
    image = np.vstack([ball(2, 150.0, random), in_ct.apply(FRAME) + random.normal(size=(4, 3)) * 0.05])
    physical = np.vstack([in_room.apply(FRAME) + random.normal(size=(4, 3)) * 0.1, ball(3, 300.0, random)])
    found = match_by_template(FRAME, image, physical, **SIGMAS)
    assert found.status is MatchStatus.UNIQUE, found.reason
    assert found.pairs.tolist() == [[2, 0], [3, 1], [4, 2], [5, 3]]
    assert found.unmatched_image == (0, 1)
    assert found.unmatched_physical == (4, 5, 6)
    truth = in_room * in_ct.inv()
    assert (found.transform.rotation.inv() * truth.rotation).magnitude() < 0.01


@pytest.mark.parametrize("side", ["image", "physical"])
def test_a_hidden_sphere_of_the_frame_is_reported_with_its_side(random, any_pose, side):
    seen = {"image": FRAME, "physical": any_pose(random).apply(FRAME)}
    seen[side] = seen[side][:3]
    found = match_by_template(FRAME, seen["image"], seen["physical"], **SIGMAS)
    assert found.status is MatchStatus.TOO_FEW
    assert f"among the {side} points" in found.reason
    assert found.transform is None


def test_two_visible_frames_are_ambiguous(random, any_pose):
    physical = np.vstack([any_pose(random).apply(FRAME), any_pose(random).apply(FRAME) + 400.0])
    found = match_by_template(FRAME, FRAME, physical, **SIGMAS)
    assert found.status is MatchStatus.AMBIGUOUS


def test_an_orientation_excluded_by_the_prior_is_refused(random, any_pose):
    turn = any_pose(random)
    prior = Prior(Rotation.from_rotvec([0.0, 0.0, np.pi]) * turn.rotation)
    found = match_by_template(FRAME, FRAME, turn.apply(FRAME), prior=prior, **SIGMAS)
    assert found.status is MatchStatus.INCONSISTENT
    assert "orientation that the prior excludes" in found.reason
    assert found.runner_up.pairs.tolist() == [[0, 0], [1, 1], [2, 2], [3, 3]]


def test_a_known_orientation_distinguishes_two_visible_frames(random, any_pose):
    turn = any_pose(random)
    other = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * turn.rotation
    physical = np.vstack([turn.apply(FRAME), other.apply(FRAME) + 900.0])
    in_ct = any_pose(random)
    image = in_ct.apply(FRAME)
    found = match_by_template(FRAME, image, physical, prior=turn.rotation * in_ct.rotation.inv(), **SIGMAS)
    assert found.status is MatchStatus.UNIQUE, found.reason
    assert found.pairs.tolist() == [[0, 0], [1, 1], [2, 2], [3, 3]]


def test_sides_that_fit_the_template_but_not_each_other_are_refused(random, any_pose):
    """A coarse template lets both sides pass that differ by more than their own noise."""
    bent = FRAME + np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [1.0, 1.0, 0]])
    found = match_by_template(
        FRAME,
        FRAME,
        any_pose(random).apply(bent),
        sigma_image_mm=0.02,
        sigma_physical_mm=0.02,
        sigma_template_mm=1.0,
    )
    assert found.status is MatchStatus.INCONSISTENT
    assert "differ beyond the noise" in found.reason
    assert found.runner_up.chi_square > found.runner_up.chi_square_limit


def test_a_template_with_missing_values_is_refused():
    with raises(BAD_POINTS, match="REG-001"):
        match_by_template(np.full((4, 3), np.nan), FRAME, FRAME, **SIGMAS)


OTHERS_MM = np.array([[80.0, 20.0, -40.0], [-70.0, 66.0, -20.0], [10.0, -90.0, -60.0]])


def scan_of(spheres_mm: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The spheres in any pose and order, with the scale error of a scanner; and where each of them went."""
    random = np.random.default_rng(seed)
    pose = RigidTransform.from_components(random.uniform(-300, 300, 3), Rotation.random(rng=random))
    seen = pose.apply(spheres_mm * random.uniform(0.999, 1.001)) + 0.02 * random.normal(size=spheres_mm.shape)
    order = random.permutation(len(seen))
    return seen[order], np.argsort(order)


@pytest.mark.parametrize("seed", range(20))
def test_the_frame_is_found_among_other_spheres_in_its_own_order(seed: int) -> None:
    spheres, where = scan_of(np.vstack([FRAME, OTHERS_MM]), seed)
    found = find_layout(FRAME, spheres)
    assert found.order.tolist() == where[:4].tolist()
    assert sorted(found.others) == sorted(where[4:].tolist())
    assert found.residual_rms_mm < 0.15


@pytest.mark.parametrize(
    "spheres_mm",
    [
        FRAME[:3],  # one is missing
        FRAME + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [1.5, 0, 0]]),  # one was bent
        np.vstack([FRAME[:3], OTHERS_MM]),
        np.vstack([FRAME, FRAME + np.array([0.0, 0.0, 60.0])]),  # two frames
    ],
)
def test_a_scan_with_an_incomplete_frame_or_with_two_frames_is_refused(spheres_mm: np.ndarray) -> None:
    with pytest.raises(LayoutNotFound, match="REG-012"):
        find_layout(FRAME, scan_of(spheres_mm, 1)[0])


def test_a_scan_of_too_many_spheres_is_refused_by_their_number() -> None:
    crowd = np.random.default_rng(1).uniform(-90.0, 90.0, (45, 3))
    with pytest.raises(LayoutNotFound, match=r"REG-012.*expected at most 40, got 45.*--pick"):
        find_layout(FRAME, crowd)


def test_a_layout_in_another_unit_is_refused_with_both_widths() -> None:
    with pytest.raises(LayoutNotFound) as refused:
        find_layout(FRAME / 10.0, scan_of(FRAME, 1)[0])
    widest_mm = max(float(np.linalg.norm(a - b)) for a in FRAME for b in FRAME)
    assert f"up to {widest_mm / 10.0:.1f} mm apart" in refused.value.expected
    assert "the layout is in mm" in refused.value.advice
