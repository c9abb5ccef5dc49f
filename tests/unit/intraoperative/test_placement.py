"""A scan is placed in the CT by bone and spheres together; spheres that contradict the bone are refused."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.intraoperative.bone_pose import PoseEstimate
from procedures.intraoperative.errors import BoneUncertain, SpheresContradict
from procedures.intraoperative.placement import ScannedSpheres, are_unmoved, place_scan, require_certain
from ronna_hw.arrays import Array

CT_MM = np.array(
    [
        [50.0, -45.0, 80.0],
        [-70.0, -40.0, 55.0],
        [25.0, -77.0, 70.0],
        [-15.0, -30.0, 100.0],
        [-14.0, -109.0, 14.0],
    ]
)
TARGET_MM = np.array([[0.0, 0.0, 0.0]])
CT_FROM_SCAN = RigidTransform.from_components([12.0, -8.0, 30.0], Rotation.from_rotvec([0.2, -0.1, 0.15]))
SIGMA_MM, SEATING_MM = 0.015, 0.05


def spheres(places_mm: Array) -> ScannedSpheres:
    return ScannedSpheres(places_mm, np.tile(np.eye(3) * SIGMA_MM**2, (len(places_mm), 1, 1)))


def bone(off_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), *, sigma_mm: float = 0.1) -> PoseEstimate:
    """Return the pose by bone, off by this much, with an error as large per axis and about 2 mrad."""
    exact = PoseEstimate(CT_FROM_SCAN, np.zeros(3), np.diag([0.002**2] * 3 + [sigma_mm**2] * 3))
    return exact.moved(np.array([0.0, 0.0, 0.0, *off_mm]), exact.covariance)


def in_scan(ct_mm: Array, seed: int = 1) -> Array:
    refitted_mm = ct_mm + np.random.default_rng(seed).normal(0.0, SEATING_MM, ct_mm.shape)
    return np.asarray(CT_FROM_SCAN.inv().apply(refitted_mm))


def test_spheres_make_the_place_better_than_bone_alone_and_say_by_how_much() -> None:
    by_bone = bone((0.15, -0.1, 0.1))
    placed = place_scan(by_bone, spheres(in_scan(CT_MM)), spheres(CT_MM), SEATING_MM)
    assert placed.agreeing == len(CT_MM)
    truly_mm = CT_FROM_SCAN.inv().apply(TARGET_MM)
    errors_mm = [
        float(np.linalg.norm(pose.ct_from_scan.apply(truly_mm) - TARGET_MM))
        for pose in (by_bone, placed.pose)
    ]
    stated_mm = [
        float(np.sqrt(np.trace(one.covariances_mm2(TARGET_MM)[0]))) for one in (by_bone, placed.pose)
    ]
    assert errors_mm[1] < 0.5 * errors_mm[0]
    assert stated_mm[1] < 0.5 * stated_mm[0]
    assert errors_mm[1] < 3.0 * stated_mm[1]


def test_stated_errors_of_the_place_are_those_that_it_has() -> None:
    squares = []
    generator = np.random.default_rng(5)
    for seed in range(60):
        step = generator.normal(0.0, [0.002] * 3 + [0.1] * 3)
        exact = bone()
        by_bone = exact.moved(step, exact.covariance)
        placed = place_scan(by_bone, spheres(in_scan(CT_MM, seed)), spheres(CT_MM), SEATING_MM)
        off_mm = (placed.pose.ct_from_scan.apply(CT_FROM_SCAN.inv().apply(TARGET_MM)) - TARGET_MM)[0]
        squares.append(off_mm @ np.linalg.solve(placed.pose.covariances_mm2(TARGET_MM)[0], off_mm) / 3.0)
    assert 0.7 < np.mean(squares) < 1.4


def test_the_stated_error_holds_for_spheres_that_have_moved_together_unnoticed() -> None:
    generator = np.random.default_rng(7)
    squares, honest_squares, refused = [], [], 0
    for seed in range(80):
        exact = bone()
        by_bone = exact.moved(generator.normal(0.0, [0.002] * 3 + [0.1] * 3), exact.covariance)
        direction = generator.normal(size=3)
        together_mm = 0.35 * direction / np.linalg.norm(direction)
        try:
            placed = place_scan(
                by_bone, spheres(in_scan(CT_MM + together_mm, seed)), spheres(CT_MM), SEATING_MM
            )
        except SpheresContradict:
            refused += 1
            continue
        off_mm = (placed.pose.ct_from_scan.apply(CT_FROM_SCAN.inv().apply(TARGET_MM)) - TARGET_MM)[0]
        for pose, found in ((placed.stated_pose, squares), (placed.pose, honest_squares)):
            found.append(off_mm @ off_mm / np.trace(pose.covariances_mm2(TARGET_MM)[0]))
    assert 0 < refused < 40
    assert np.mean(squares) < 1.0 < np.mean(honest_squares)


def test_spheres_that_sit_as_in_the_ct_are_noticed_and_refitted_ones_are_not() -> None:
    again = place_scan(bone(), spheres(CT_FROM_SCAN.inv().apply(CT_MM)), spheres(CT_MM), SEATING_MM)
    assert are_unmoved(again, SEATING_MM)
    for seed in range(20):
        placed = place_scan(bone(), spheres(in_scan(CT_MM, seed)), spheres(CT_MM), SEATING_MM)
        assert not are_unmoved(placed, SEATING_MM)


@pytest.mark.hazard(68)
@pytest.mark.parametrize("by_mm", [(1.0, 0.0, 0.0), (0.0, -2.0, 1.5)])
def test_a_sphere_that_moved_since_the_ct_is_named_and_takes_no_part(
    by_mm: tuple[float, float, float],
) -> None:
    moved_mm = CT_MM.copy()
    moved_mm[2] += by_mm
    placed = place_scan(bone((0.05, 0.05, -0.1)), spheres(in_scan(moved_mm)), spheres(CT_MM), SEATING_MM)
    (left,) = [pair for pair in placed.pairs if not pair.agrees]
    assert (left.scan, left.ct) == (2, 2)
    assert left.moved_mm == pytest.approx(float(np.linalg.norm(by_mm)), abs=0.25)


def test_a_sphere_on_another_screw_is_no_pair() -> None:
    shown_mm = np.vstack([CT_MM[:4], [[60.0, 20.0, 70.0]]])
    placed = place_scan(bone(), spheres(in_scan(shown_mm)), spheres(CT_MM), SEATING_MM)
    assert [(pair.scan, pair.ct) for pair in placed.pairs] == [(0, 0), (1, 1), (2, 2), (3, 3)]


@pytest.mark.hazard(68)
def test_spheres_that_moved_together_contradict_the_bone() -> None:
    moved_mm = CT_MM + np.array([0.0, 1.5, 0.0])
    with raises(SpheresContradict, match="5 spheres keep their distances"):
        place_scan(bone(), spheres(in_scan(moved_mm)), spheres(CT_MM), SEATING_MM)


@pytest.mark.parametrize("by_mm", [(0.4, 0.0, 0.0), (0.0, -0.3, 0.3)])
def test_spheres_that_moved_together_by_little_contradict_a_bone_that_is_known_better(
    by_mm: tuple[float, float, float],
) -> None:
    scan = spheres(in_scan(CT_MM + np.array(by_mm)))
    with raises(SpheresContradict, match="together beside where the bone has them"):
        place_scan(bone(sigma_mm=0.05), scan, spheres(CT_MM), SEATING_MM)


@pytest.mark.parametrize("by_mm", [(0.5, 0.0, 0.0), (0.0, 0.35, 0.35), (-0.3, 0.0, 0.3)])
def test_a_sphere_that_moved_alone_is_named_even_if_all_still_fit_each_other(
    by_mm: tuple[float, float, float],
) -> None:
    moved_mm = CT_MM.copy()
    moved_mm[2] += by_mm
    for seed in range(30):
        placed = place_scan(bone(sigma_mm=0.05), spheres(in_scan(moved_mm, seed)), spheres(CT_MM), SEATING_MM)
        assert [pair.ct for pair in placed.pairs if not pair.agrees] == [2], seed


@pytest.mark.hazard(68)
def test_a_mirrored_scan_contradicts_the_bone_of_a_symmetric_head() -> None:
    with raises(SpheresContradict, match="hardly any sphere"):
        place_scan(bone(), spheres(in_scan(CT_MM * (-1.0, 1.0, 1.0))), spheres(CT_MM), SEATING_MM)


@pytest.mark.hazard(68)
def test_a_place_that_is_too_uncertain_at_a_target_is_refused() -> None:
    with raises(BoneUncertain, match="place of the scan"):
        require_certain(bone(sigma_mm=0.4), TARGET_MM)
    require_certain(bone(), TARGET_MM)
