"""A scan is registered to the surface in the CT, and its predicted error is the error that it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.error_sources import LINE, SKIN
from procedures.registration.surface.checks import SurfaceLimits
from procedures.registration.surface.errors import SKIN_CHANGED
from procedures.registration.surface.global_search import find_pose
from procedures.registration.surface.peers import register_by_closest_points
from procedures.registration.surface.settling import Pose, Settled
from procedures.registration.surface.starts import Start
from procedures.registration.surface.surface_registration import register_surface
from procedures.registration.target_prediction import SharedErrors
from ronna_hw.errors import RefusedError
from ronna_hw.frames import Frame, Transform

FACE = ((0.0, -1.0, 0.0),)
VAULT = ((0.0, -0.6, 1.0), (0.0, 0.0, 1.0), (0.5, -0.5, 1.0), (-0.5, -0.5, 1.0))
TARGETS_MM = np.array([[-20.0, -20.0, -20.0], [20.0, 10.0, 25.0], [0.0, 40.0, 0.0]])

# Views, size, length and offset of the misfit: a smooth field, which no hypothesis has.
CASES = (
    (None, 0.3, 15.0, 0.0),
    (None, 0.2, 30.0, 0.1),
    (FACE, 0.2, 20.0, 0.05),
    (VAULT, 0.2, 25.0, 0.05),
)


def judge(heads, scan_of, seeds):
    """Normalised square at each target, whether the 95 % limit contains the error, and what is refused."""
    squares, contained, refused = [], [], 0
    for seed in seeds:
        views, size, length, offset = CASES[seed % len(CASES)]
        shown = {} if views is None else {"views": views}
        level = offset * float(np.random.default_rng(seed).normal())
        head = heads[seed % len(heads)]
        made = scan_of(head, 1000 + seed, misfit_mm=size, length_mm=length, offset_mm=level, **shown)
        try:
            found = register_surface(made.scan, head, made.start)
        except RefusedError as problem:
            refused += problem.code == SKIN_CHANGED.code
            continue
        for target, error in zip(TARGETS_MM, made.errors_mm(found.robot_from_ct), strict=True):
            predicted = found.predict(target)
            squares.append(error @ np.linalg.solve(predicted.covariance_mm2, error) / 3.0)
            contained.append(np.linalg.norm(error) < predicted.limit_mm())
    return float(np.mean(squares)), float(np.mean(contained)), refused / len(seeds)


def test_the_predicted_error_is_of_the_size_of_the_error(heads, scan_of):
    square, contained, refused = judge(heads, scan_of, range(8))
    assert refused == 0.0
    assert 0.2 < square < 2.5
    assert contained >= 0.75


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_over_many_misfits_of_another_kind_the_limits_contain_the_errors(made_head, scan_of):
    square, contained, refused = judge([made_head(seed) for seed in range(10, 17)], scan_of, range(200))
    assert 0.4 < square < 1.4, contained
    assert contained > 0.93, square
    assert refused < 0.05


def test_neither_the_order_of_the_points_nor_a_second_run_changes_a_bit(heads, scan_of, random):
    made = scan_of(heads[0], 7, count=120)
    first = register_surface(made.scan, heads[0], made.start)
    shuffled = register_surface(made.scan.select(random.permutation(len(made.scan))), heads[0], made.start)
    for other in (shuffled, register_surface(made.scan, heads[0], made.start)):
        assert np.array_equal(first.robot_from_ct.as_matrix(), other.robot_from_ct.as_matrix())
        assert first.predict(TARGETS_MM[0]).limit_mm() == other.predict(TARGETS_MM[0]).limit_mm()


@pytest.mark.parametrize("seed", [7, 8, 11])
def test_where_the_cart_stands_changes_next_to_nothing(heads, scan_of, seed):
    made = scan_of(heads[0], seed, count=300)
    turned = Transform(
        Frame.ROBOT,
        Frame.ROBOT,
        RigidTransform.from_components([50.0, 20.0, 7.0], Rotation.from_rotvec([0, 0, 0.7])),
    )
    start = Start(turned @ made.start.robot_from_ct, made.start.turn_rad, made.start.place_mm)
    here = register_surface(made.scan, heads[0], made.start)
    there = register_surface(made.scan.placed(turned), heads[0], start)
    apart_mm = there.robot_from_ct.apply(TARGETS_MM) - turned.apply(here.robot_from_ct.apply(TARGETS_MM))
    assert np.linalg.norm(apart_mm, axis=1).max() < 1e-3 * here.predict(TARGETS_MM[0]).rms_mm


def test_lines_that_were_taken_twice_leave_the_hair_out_as_before(heads, scan_of, random):
    def hair(places):
        return np.where(places[:, 2] > 30.0, 2.0 * random.uniform(size=len(places)), 0.0)

    made = scan_of(heads[0], 8, count=600, outwards=hair)
    once = register_surface(made.scan, heads[0], made.start)
    again = type(made.scan).join([made.scan] * 5)
    twice = register_surface(again, heads[0], made.start)
    assert once.excluded.mean() > 0.05
    assert twice.excluded.mean() == pytest.approx(once.excluded.mean(), abs=0.05)


def test_the_cloud_alone_finds_its_pose(heads, scan_of):
    made = scan_of(heads[1], 11)
    found = register_surface(made.scan, heads[1])
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 1.0


def test_three_landmarks_are_a_start(heads, scan_of, random):
    made = scan_of(heads[1], 12)
    landmarks = np.array([[0.0, -95.0, -40.0], [78.0, 5.0, -42.0], [-78.0, 5.0, -42.0]])
    pointed = made.truth.apply(landmarks) + random.normal(size=(3, 3)) * 2.0
    found = register_surface(made.scan, heads[1], Start.from_landmarks(landmarks, pointed))
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 1.0


def test_a_hand_in_the_scan_is_excluded_and_changes_little(heads, scan_of):
    def hand(places):
        return np.where(np.linalg.norm(places - [60.0, -40.0, 10.0], axis=1) < 35.0, 25.0, 0.0)

    made = scan_of(heads[0], 13, outwards=hand)
    found = register_surface(made.scan, heads[0], made.start)
    assert found.excluded.sum() >= 3
    assert np.abs(found.residuals_mm[~found.excluded]).max() < 3.0
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 1.0


def test_an_error_that_the_arm_has_at_the_target_too_cancels(heads, scan_of):
    made = scan_of(heads[0], 14, views=FACE)
    looks, step = len(np.unique(made.scan.look)), 2.0 * np.eye(3)
    arm = [SharedErrors("tool", np.tile(step, (looks, 1, 1)), step)]
    found = register_surface(made.scan, heads[0], made.start, arm=arm)
    alone = register_surface(made.scan, heads[0], made.start)
    elsewhere = [SharedErrors("tool", np.tile(step, (looks, 1, 1)), -step)]
    assert found.predict(TARGETS_MM[0], elsewhere).rms_mm > 3.0
    together = found.predict(TARGETS_MM[0], arm)
    assert together.rms_mm == pytest.approx(alone.predict(TARGETS_MM[0]).rms_mm, rel=0.1)


def test_what_the_arm_errs_between_looks_is_made_up_for_by_the_skin_alone(heads, scan_of):
    without, left, predicted = [], [], []
    for seed in range(8):
        made = scan_of(heads[seed % 2], 800 + seed, misfit_mm=0.05)
        looks = np.unique(made.scan.look)
        by_look = np.zeros((len(looks), 3, 3))
        by_look[0] = 0.5 * np.eye(3)  # in the posture of the target, in front of the face
        arm = [SharedErrors("arm", by_look, 0.5 * np.eye(3))]
        off_mm = 0.5 * np.random.default_rng(seed).normal(size=3)
        seen = replace(made.scan, points_mm=made.scan.points_mm - off_mm * (made.scan.look == 0)[:, None])
        found = register_surface(seen, heads[seed % 2], made.start, arm=arm)
        correction_mm, limit_mm = found.correct(arm)
        assert np.linalg.norm(correction_mm) < limit_mm
        pose_mm = made.errors_mm(found.robot_from_ct)[0]
        without.append(float(np.sum((pose_mm + off_mm) ** 2)))
        left.append(float(np.sum((pose_mm + off_mm + correction_mm) ** 2)))
        predicted.append(found.predict(TARGETS_MM[0], arm).rms_mm ** 2)
    assert np.mean(left) < 0.3 * np.mean(without), (left, without)
    assert 0.3 < np.mean(left) / np.mean(predicted) < 2.5, (left, predicted)


def test_a_point_beside_a_fold_stays_on_its_part_as_the_pose_moves(heads):
    points_mm = heads[0].points_mm[:3]
    found = Settled.at(Pose(np.eye(3), np.zeros(3)), points_mm, 4.0 * points_mm, heads[0])
    jumped = replace(found, distances_mm=np.array([0.1, -5.0, 0.3]), valid=np.array([True, True, False]))
    kept = jumped.on_the_same_parts(np.array([0.15, 0.2, 0.25]))
    assert kept.distances_mm.tolist() == [0.1, 0.2, 0.25]


def test_the_shares_of_skin_scan_and_arm_add_up_to_the_predicted_square(heads, scan_of):
    made = scan_of(heads[0], 5)
    looks = len(np.unique(made.scan.look))
    shift = np.zeros((looks, 3, 1))
    shift[:, 0] = 0.5
    alike = SharedErrors("alike", shift, shift[0])
    only_here = SharedErrors("only here", np.zeros_like(shift), shift[0])
    arm = [alike, only_here]
    found = register_surface(made.scan, heads[0], made.start, arm=arm)
    shares = found.split(TARGETS_MM[0], arm)
    assert sum(shares.values()) == pytest.approx(found.predict(TARGETS_MM[0], arm).rms_mm ** 2)
    assert list(shares) == [SKIN, LINE, "alike", "only here"]
    assert shares["alike"] < 0.01  # it displaces scan and target by the same
    assert shares["only here"] == pytest.approx(0.25)
    assert shares[SKIN] > shares[LINE] > 0.0


def test_errors_of_the_arm_are_matched_by_their_names(heads, scan_of):
    made = scan_of(heads[0], 14, views=FACE)
    looks = len(np.unique(made.scan.look))
    sources = [
        SharedErrors(name, np.tile(step, (looks, 1, 1)), step)
        for name, step in (("tool", 2.0 * np.eye(3)), ("mount", 0.5 * np.eye(3)))
    ]
    found = register_surface(made.scan, heads[0], made.start, arm=sources)
    before, exchanged = (found.predict(TARGETS_MM[0], one).rms_mm for one in (sources, sources[::-1]))
    assert exchanged == pytest.approx(before)
    assert found.predict(TARGETS_MM[0], sources[:1]).rms_mm > before


def test_the_misfit_that_the_scan_has_is_found(heads, scan_of):
    small, large = (
        register_surface((made := scan_of(heads[0], 15, misfit_mm=size)).scan, heads[0], made.start)
        for size in (0.05, 0.4)
    )
    assert small.misfit_mm < 0.15
    assert 0.25 < large.misfit_mm < 0.9
    assert large.predict(TARGETS_MM[0]).limit_mm() > 1.5 * small.predict(TARGETS_MM[0]).limit_mm()


def test_closest_points_of_the_thesis_register_the_same_scan(heads, scan_of):
    made = scan_of(heads[0], 16)
    pose = register_by_closest_points(made.scan, heads[0], made.start)
    assert np.linalg.norm(made.errors_mm(pose), axis=1).max() < 5.0


@pytest.mark.parametrize("views", [None, FACE])
def test_the_pose_is_found_by_the_scan_alone_also_of_the_face_alone(heads, scan_of, views):
    shown = {} if views is None else {"views": views}
    for seed, head in enumerate(heads):
        made = scan_of(head, 40 + seed, **shown)
        found = find_pose(made.scan.points_mm, made.scan.view_mm, head, SurfaceLimits().largest_residual_mm)
        there = made.truth.inverse().apply(made.scan.points_mm)
        assert np.linalg.norm(found.pose.apply(made.scan.points_mm) - there, axis=1).max() < 4.0
