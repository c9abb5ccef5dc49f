"""Registration together with the arm's errors: exact where the problem is linear, honest about the rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from procedures.registration.arm_adjustment import PlannedAdjustment, best_influence
from procedures.registration.arm_hypotheses import (
    ACCEPTABLE,
    HYPOTHESES,
    STATED,
    Hypothesis,
    Source,
    at_looks,
    share_by_sphere,
)
from procedures.registration.arm_learning import ArmLearning, Looks
from procedures.registration.error_theory import chi_square_limit
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import (
    IndependentErrors,
    SharedErrors,
    influence_of_spheres,
    predict_by_influence,
)
from ronna_hw.arrays import Array
from studies.accuracy.many_learned import LearnedRegistration, TargetSources

SPHERES = np.array([[80.0, 0, 0], [0, 90, 20], [-70, -10, 40], [10, -80, 0], [-40, 60, -30]])
TARGET = np.array([5.0, 10.0, -40.0])
NOISE_MM, CT_MM = 0.02, 0.05
TWICE = tuple(range(5)) * 2  # every sphere seen from two sides


def own_errors(looks: int, per_axis_mm: float = NOISE_MM) -> IndependentErrors:
    own = np.tile(np.eye(3) * per_axis_mm**2, (looks, 1, 1))
    return IndependentErrors("repeatability", own, np.eye(3) * per_axis_mm**2)


def ct_of_spheres(spheres: tuple[int, ...], per_axis_mm: float = CT_MM) -> SharedErrors:
    own = np.tile(np.eye(3) * per_axis_mm**2, (len(spheres), 1, 1))
    return share_by_sphere(IndependentErrors("CT", own, np.zeros((3, 3))), spheres)


def arm_errors(looks: int, size_mm: float = 0.3) -> SharedErrors:
    columns = size_mm * np.random.default_rng(8).normal(size=(looks + 1, 3, 4))
    return SharedErrors("arm", columns[:-1], columns[-1])


def other_errors() -> list[Source]:
    return [own_errors(10), ct_of_spheres(TWICE)]


def draw_residuals(random: np.random.Generator, arm: SharedErrors, share: float) -> tuple[Array, Array]:
    """Draw residuals (m, 3) of two looks at each sphere, and the error (3,) of the tool at the target."""
    size = share * random.normal(size=arm.at_target_mm.shape[1])
    at_looks = arm.at_spheres_mm @ size + NOISE_MM * random.normal(size=(10, 3))
    ct = CT_MM * random.normal(size=(5, 3))
    return -at_looks - ct[list(TWICE)], arm.at_target_mm @ size + NOISE_MM * random.normal(size=3)


def test_without_errors_of_the_arm_the_best_influence_is_that_of_a_weighted_fit() -> None:
    own = np.array([np.diag([0.01, 0.02, 0.09]), *([np.eye(3) * 0.01] * 4)])
    expected = influence_of_spheres(SPHERES, TARGET, np.linalg.inv(own))
    found = best_influence(SPHERES, TARGET, [IndependentErrors("CT", own, np.zeros((3, 3)))])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_best_influence_keeps_the_pose_unbiased_and_no_other_unbiased_one_predicts_better() -> None:
    sources = [arm_errors(10), *other_errors()]
    points = SPHERES[list(TWICE)]
    best = best_influence(points, TARGET, sources)
    centre = points.mean(axis=0)
    moved = np.einsum("nij,njk->ik", best, pose_jacobian(points, centre))
    np.testing.assert_allclose(moved, pose_jacobian(TARGET, centre), atol=1e-9)
    plain = influence_of_spheres(points, TARGET)
    rms_mm = predict_by_influence(best, sources).rms_mm
    assert rms_mm < 0.5 * predict_by_influence(plain, sources).rms_mm
    for share in (-0.05, 0.05):
        beside = best + share * (plain - best)
        assert predict_by_influence(beside, sources).rms_mm > rms_mm


def test_a_moved_head_leaves_no_residual_and_moves_the_target_with_it() -> None:
    points = SPHERES[list(TWICE)]
    step = np.array([1e-4, -2e-4, 1e-4, 0.3, -0.2, 0.1])
    centre = points.mean(axis=0)
    moved = pose_jacobian(points, centre) @ step
    arm: list[Source] = [arm_errors(10)]
    others = other_errors()
    learned = ArmLearning.of(Looks(moved, points, arm, others))
    found = learned.at_target(TARGET, arm, others)
    np.testing.assert_allclose(found.shift_mm, pose_jacobian(TARGET, centre) @ step, atol=1e-9)
    assert learned.residual.chi_square == pytest.approx(0.0, abs=1e-6)
    places, _ = learned.spheres_mm([(number, number + 5) for number in range(5)])
    np.testing.assert_allclose(places, SPHERES + moved[:5], atol=1e-9)


@pytest.mark.hazard(67)
@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_the_limit_holds_on_arms_better_and_worse_than_stated(share: float) -> None:
    random, points = np.random.default_rng(31), SPHERES[list(TWICE)]
    arm, others = arm_errors(10), other_errors()
    drawn = [draw_residuals(random, arm, share) for _ in range(500)]
    residuals, at_target = (np.array(one) for one in zip(*drawn, strict=True))
    judged = LearnedRegistration.of(points, TWICE, [TargetSources(TARGET, [arm], others)]).judge(residuals)
    plain = np.einsum("nij,anj->ai", influence_of_spheres(points, TARGET), residuals)
    learned_mm, plain_mm = (
        np.linalg.norm(one + at_target, axis=1) for one in (judged.shifts_mm[:, 0], plain)
    )
    assert 0.93 <= np.mean(learned_mm <= judged.limits_mm()[:, 0]) <= 0.99
    assert learned_mm.mean() < 0.6 * plain_mm.mean()


def test_an_arm_worse_than_stated_is_noticed() -> None:
    points, arm = SPHERES[list(TWICE)], arm_errors(10)
    shares = []
    for share in (0.5, 2.0):
        residuals, _ = draw_residuals(np.random.default_rng(31), arm, share)
        looks = Looks(residuals, points, [arm], other_errors())
        shares.append(ArmLearning.of(looks).share)
    assert shares[0] < 1.0 < shares[1]


@pytest.mark.hazard(67)
def test_looks_that_scatter_more_than_any_hypothesis_leave_a_residual_that_is_refused() -> None:
    random, points = np.random.default_rng(4), SPHERES[list(TWICE)]
    residuals, _ = draw_residuals(random, arm_errors(10), 1.0)
    others = other_errors()
    usual = ArmLearning.of(Looks(residuals, points, [arm_errors(10)], others)).residual
    bumped = residuals + 2.0 * random.normal(size=residuals.shape)
    unlike = ArmLearning.of(Looks(bumped, points, [arm_errors(10)], others)).residual
    limit = chi_square_limit(usual.freedom, 0.999)
    assert usual.chi_square < limit < unlike.chi_square


def test_a_sphere_that_has_moved_stands_out_until_its_looks_are_left_out() -> None:
    random, points = np.random.default_rng(6), SPHERES[list(TWICE)]
    residuals, _ = draw_residuals(random, arm_errors(10), 1.0)
    residuals[[3, 8]] += [4.0, 0.0, 0.0]
    arm: list[Source] = [arm_errors(10)]
    others = other_errors()
    kept = [look for look in range(10) if look not in (3, 8)]
    whole = ArmLearning.of(Looks(residuals, points, arm, others))
    rest = ArmLearning.of(Looks(residuals[kept], points[kept], at_looks(arm, kept), at_looks(others, kept)))
    assert whole.residual.chi_square > chi_square_limit(whole.residual.freedom, 0.999)
    assert rest.residual.chi_square < chi_square_limit(rest.residual.freedom, 0.999)
    assert rest.residual.freedom == whole.residual.freedom - 6


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_the_gate_notices_a_moved_sphere_sooner_than_by_the_largest_errors_and_refuses_no_right_arm(
    share: float,
) -> None:
    random, arm, others = np.random.default_rng(77), arm_errors(10), other_errors()
    planned = PlannedAdjustment.of(SPHERES[list(TWICE)], [arm], others)
    largest = int(np.flatnonzero(ACCEPTABLE)[-1])
    right = np.array([draw_residuals(random, arm, share)[0] for _ in range(300)])
    moved = right.copy()
    moved[:, [2, 7]] += 0.6 * Rotation.random(300, random).as_matrix()[:, None, 0]
    limit = chi_square_limit(24, 0.999)
    of_right, of_moved = (planned.judge(one.reshape(300, -1)) for one in (right, moved))
    assert np.mean(of_right.acceptable > limit) <= 0.01
    assert np.all(of_moved.acceptable >= of_moved.chi_squares[:, largest] - 1e-9)
    noticed, by_largest = (
        np.mean(one > limit) for one in (of_moved.acceptable, of_moved.chi_squares[:, largest])
    )
    assert noticed > by_largest + 0.05


def test_looks_at_one_sphere_share_its_error_and_looks_at_others_do_not() -> None:
    shared = ct_of_spheres((0, 1, 0))
    columns = shared.at_spheres_mm.reshape(9, -1)
    own = np.eye(3) * CT_MM**2
    expected = block_diag(own, own, own)
    expected[:3, 6:] = expected[6:, :3] = own
    np.testing.assert_allclose(columns @ columns.T, expected, atol=1e-15)
    assert not shared.at_target_mm.any()


def test_a_hypothesis_scales_the_arm_alone_and_adds_its_scatter_everywhere() -> None:
    arm, noise = arm_errors(4), own_errors(4)
    found = Hypothesis(2.0, 0.06).sources([arm], [noise])
    assert STATED in HYPOTHESES
    scaled, other, lacking = found
    assert isinstance(scaled, SharedErrors)
    assert isinstance(lacking, IndependentErrors)
    np.testing.assert_allclose(scaled.at_target_mm, 2.0 * arm.at_target_mm)
    assert other is noise
    np.testing.assert_allclose(lacking.at_spheres_mm2, np.tile(np.eye(3) * 0.06**2, (4, 1, 1)))
