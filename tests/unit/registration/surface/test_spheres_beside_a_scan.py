"""Spheres on screws take part in the adjustment of a scan, and one that has moved is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from procedures.registration.error_sources import LINE, SKIN, SPHERES
from procedures.registration.surface.spheres import LookedSpheres
from procedures.registration.surface.surface_registration import register_surface
from procedures.registration.target_prediction import SharedErrors
from ronna_hw.errors import RonnaError

SCREWS_MM = np.array([[30.0, -30.0, 85.0], [-55.0, 40.0, 70.0], [-20.0, -80.0, 55.0]])
ERROR_MM = 0.08  # per axis, of CT, seating and look
DEEP_MM = np.array([[-20.0, -20.0, -20.0], [20.0, 10.0, 25.0], [0.0, 40.0, 0.0]])


def look_at(made, count, seed, moved=0.0):
    """Looks at the first screws of a scanned head, the last of them `moved` along x."""
    random = np.random.default_rng(seed)
    there = made.truth.apply(SCREWS_MM[:count]) + ERROR_MM * random.normal(size=(count, 3))
    there[-1, 0] += moved
    return LookedSpheres(np.arange(count), SCREWS_MM[:count], there, np.eye(3 * count) * ERROR_MM**2)


def errors_by_screws(heads, scan_of, counts, seeds=range(6)):
    """Rms error at deep targets, predicted rms, and share within the limit, by the number of screws."""
    found = {}
    for count in counts:
        squares, predicted, within = [], [], []
        for seed in seeds:
            made = scan_of(heads[seed % 2], 300 + seed, misfit_mm=0.4, length_mm=25.0)
            spheres = look_at(made, count, seed) if count else None
            fit = register_surface(made.scan, heads[seed % 2], made.start, spheres=spheres)
            errors = np.linalg.norm(made.errors_mm(fit.robot_from_ct, DEEP_MM), axis=1)
            expected = [fit.predict(one) for one in DEEP_MM]
            squares += (errors**2).tolist()
            predicted += [one.rms_mm**2 for one in expected]
            within += [one.limit_mm() > error for one, error in zip(expected, errors, strict=True)]
        found[count] = tuple(
            float(np.mean(one) ** power) for one, power in ((squares, 0.5), (predicted, 0.5), (within, 1.0))
        )
    return found


def test_each_screw_lowers_the_error_at_deep_targets_and_the_prediction_says_so(heads, scan_of):
    found = errors_by_screws(heads, scan_of, (0, 1, 3))
    errors, predicted = ([found[count][one] for count in (0, 1, 3)] for one in (0, 1))
    assert errors[1] < 0.7 * errors[0], found
    assert errors[2] < 0.4 * errors[0], found
    assert errors == sorted(errors, reverse=True), found
    assert predicted == sorted(predicted, reverse=True), found
    assert 0.5 < errors[2] / predicted[2] < 1.6, found


def test_neither_the_order_of_the_points_nor_that_of_the_spheres_changes_the_pose(heads, scan_of, random):
    made = scan_of(heads[0], 7, count=120)
    spheres = look_at(made, 3, 1)
    back = LookedSpheres(
        spheres.numbers[::-1], spheres.image_mm[::-1], spheres.physical_mm[::-1], spheres.covariance_mm2
    )
    shuffled = made.scan.select(random.permutation(len(made.scan)))
    poses = [
        register_surface(scan, heads[0], made.start, spheres=one).robot_from_ct.as_matrix()
        for scan, one in ((made.scan, spheres), (shuffled, spheres), (made.scan, back))
    ]
    assert np.array_equal(poses[0], poses[1])
    assert poses[0] == pytest.approx(poses[2], abs=1e-9)


@pytest.mark.branch("SPHERE_OFF_SKIN")
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_sphere_that_moved_is_refused_by_its_number(heads, scan_of, count):
    made = scan_of(heads[0], 21, misfit_mm=0.1)
    with pytest.raises(RonnaError, match=f"sphere {count} is not where") as refusal:
        register_surface(made.scan, heads[0], made.start, spheres=look_at(made, count, 3, moved=2.5))
    assert refusal.value.code == "SRF-012"


def test_screws_that_have_the_skin_elsewhere_widen_the_limit_and_are_believed(heads, scan_of):
    made = scan_of(heads[0], 21, misfit_mm=0.1)
    limits_mm, errors_mm = [], []
    for slid_mm in (0.0, 0.9):  # all skin as one: it shows nothing of it itself
        points = made.scan.points_mm + made.truth.rotation_matrix @ [0.0, 0.0, slid_mm]
        found = register_surface(
            replace(made.scan, points_mm=points), heads[0], made.start, spheres=look_at(made, 3, 3)
        )
        limits_mm.append(max(found.predict(one).limit_mm() for one in DEEP_MM))
        errors_mm.append(np.linalg.norm(made.errors_mm(found.robot_from_ct, DEEP_MM), axis=1).max())
    assert limits_mm[1] > 1.1 * limits_mm[0]
    assert errors_mm[1] < 0.3


def test_an_error_of_the_arm_that_spheres_and_target_share_cancels(heads, scan_of):
    made = scan_of(heads[1], 5)
    spheres, looks = look_at(made, 3, 2), len(np.unique(made.scan.look)) + 3
    off = SharedErrors("mount", np.tile(np.eye(3) * 0.5, (looks, 1, 1)), np.eye(3) * 0.5)
    alone = register_surface(made.scan, heads[1], made.start, spheres=spheres)
    shared = register_surface(made.scan, heads[1], made.start, spheres=spheres, arm=(off,))
    target = DEEP_MM[0]
    elsewhere = SharedErrors("mount", off.at_spheres_mm, -off.at_target_mm)
    assert shared.predict(target, (elsewhere,)).rms_mm > 0.6
    assert shared.predict(target, (off,)).rms_mm == pytest.approx(alone.predict(target).rms_mm, rel=0.1)


def test_what_the_arm_errs_at_spheres_and_target_alike_is_made_up_for(heads, scan_of):
    errors, without, predicted = [], [], []
    for seed in range(8):
        made = scan_of(heads[seed % 2], 700 + seed, misfit_mm=0.1)
        looks = len(np.unique(made.scan.look))
        alike = SharedErrors("mount", np.zeros((looks + 3, 3, 3)), np.eye(3) * 0.5)
        alike.at_spheres_mm[looks:] = np.eye(3) * 0.5  # in the posture of the target, not at the skin
        off_mm = 0.5 * np.random.default_rng(seed).normal(size=3)
        spheres = look_at(made, 3, seed)
        spheres = replace(spheres, physical_mm=spheres.physical_mm - off_mm)
        found = register_surface(made.scan, heads[seed % 2], made.start, spheres=spheres, arm=(alike,))
        correction_mm, limit_mm = found.correct((alike,))
        assert np.linalg.norm(correction_mm) < limit_mm
        pose_mm = made.errors_mm(found.robot_from_ct, DEEP_MM[:1])[0]
        without.append(float(np.sum((pose_mm + off_mm) ** 2)))
        errors.append(float(np.sum((pose_mm + off_mm + correction_mm) ** 2)))
        predicted.append(found.predict(DEEP_MM[0], (alike,)).rms_mm ** 2)
    assert np.mean(errors) < 0.1 * np.mean(without), (errors, without)
    assert 0.4 < np.mean(errors) / np.mean(predicted) < 2.5, (errors, predicted)


def test_the_shares_add_up_with_an_arm_that_is_made_up_for(heads, scan_of):
    made = scan_of(heads[0], 301, misfit_mm=0.4, length_mm=25.0)
    spheres, looks = look_at(made, 3, 1), len(np.unique(made.scan.look))
    at_spheres = np.zeros((looks + 3, 3, 1))
    at_spheres[looks:, 0] = 1.0  # at spheres and target the arm errs alike, at the skin not at all
    arm = [SharedErrors("arm", at_spheres, at_spheres[-1])]
    found = register_surface(made.scan, heads[0], made.start, arm=arm, spheres=spheres)
    shares = found.split(DEEP_MM[0], arm)
    assert sum(shares.values()) == pytest.approx(found.predict(DEEP_MM[0], arm).rms_mm ** 2)
    assert list(shares) == [SKIN, LINE, SPHERES, "arm"]
    assert min(shares.values()) > 0.0
    assert shares["arm"] < 0.5  # of the 1.0 of an arm that nothing shows
