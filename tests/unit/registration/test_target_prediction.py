"""Prediction with shared errors: which cancel, how the rest passes through the fit, and the error region."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtr

from procedures.registration import register
from procedures.registration.error_theory import FreGate, chi_square_limit
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.target_prediction import (
    AllowedErrors,
    IndependentErrors,
    ResidualCheck,
    SharedErrors,
    UnnoticedPoint,
    check_residuals,
    chi_square_of_shared,
    find_unnoticed_point,
    gate_residuals,
    influence_of_spheres,
    predict_target_error,
)
from ronna_hw.arrays import Array

SPHERES = np.array([[80.0, 0, 0], [0, 90, 20], [-70, -10, 40], [10, -80, 0]])
TARGET = np.array([5.0, 10.0, -40.0])
NOTHING = np.zeros((3, 3))


def test_an_error_that_displaces_all_poses_alike_or_turns_them_about_the_base_cancels() -> None:
    def turned(point: np.ndarray) -> np.ndarray:
        return np.cross([0.0, 0.0, 1e-3], point)[:, None]

    shift = SharedErrors("tool frame", np.tile(2.0 * np.eye(3), (4, 1, 1)), 2.0 * np.eye(3))
    turn = SharedErrors("first joint", np.array([turned(one) for one in SPHERES]), turned(TARGET))
    for error in (shift, turn):
        assert predict_target_error(SPHERES, TARGET, [error]).rms_mm == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_displaced_sphere_moves_the_target_as_the_fit_says(weighted: bool) -> None:
    own = np.array([np.diag([0.01, 0.02, 0.09]), *(np.diag([0.01, 0.01, 0.01]) for _ in range(3))])
    influence = influence_of_spheres(SPHERES, TARGET, np.linalg.inv(own) if weighted else None)
    step_mm = 1e-3
    for sphere in range(4):
        for axis in range(3):
            recorded = SPHERES.copy()
            recorded[sphere, axis] += step_mm
            fit = register(SPHERES, recorded, covariance_mm2=own if weighted else None)
            moved = (fit.transform.apply(TARGET) - TARGET) / step_mm
            np.testing.assert_allclose(moved, influence[sphere, :, axis], atol=1e-4)


def test_the_region_contains_the_errors_of_many_registrations() -> None:
    random = np.random.default_rng(5)
    own = np.tile(np.diag([0.01, 0.02, 0.09]), (4, 1, 1))
    columns = 0.1 * random.normal(size=(5, 3, 2))
    predicted = predict_target_error(
        SPHERES, TARGET, [SharedErrors("arm", columns[:4], columns[4]), IndependentErrors("CT", own, NOTHING)]
    )
    errors = []
    for _ in range(800):
        size = random.normal(size=2)
        noise = np.einsum("nij,nj->ni", np.linalg.cholesky(own), random.normal(size=(4, 3)))
        fit = register(SPHERES, SPHERES - columns[:4] @ size + noise)
        errors.append(fit.transform.apply(TARGET) + columns[4] @ size - TARGET)
    np.testing.assert_allclose(np.cov(np.array(errors).T), predicted.covariance_mm2, atol=0.01)
    assert predicted.mark_contained(errors).mean() == pytest.approx(0.95, abs=0.02)
    assert sum(share**2 for share in predicted.budget_mm.values()) == pytest.approx(predicted.rms_mm**2)


POINTS_MM = np.array([[60.0, 0, 10], [-50, 30, 0], [0, -60, 20], [20, 50, -40], [-30, -20, 50]])
SIGMA_MM = 0.1
COVARIANCE_MM2 = np.tile(np.eye(3) * SIGMA_MM**2, (5, 1, 1))


def test_the_chi_square_equals_that_of_the_fit_without_shared_errors() -> None:
    generator = np.random.default_rng(1)
    fit = register(POINTS_MM, POINTS_MM + generator.normal(0.0, 0.1, (5, 3)), covariance_mm2=COVARIANCE_MM2)
    mapped = fit.transform.apply(POINTS_MM)
    found = chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, np.zeros((5, 3, 1)))
    assert found == pytest.approx(fit.chi_square, rel=1e-3)


@pytest.mark.parametrize("draws", [400, pytest.param(1000, marks=pytest.mark.slow)])
def test_residuals_with_shared_errors_follow_a_chi_square_distribution(draws: int) -> None:
    generator = np.random.default_rng(2)
    shared_mm = generator.normal(0.0, 0.3, (5, 3, 2))
    shares = []
    for _ in range(draws):
        error_mm = generator.normal(0.0, SIGMA_MM, (5, 3)) + shared_mm @ generator.normal(size=2)
        fit = register(POINTS_MM, POINTS_MM + error_mm, covariance_mm2=COVARIANCE_MM2)
        mapped = fit.transform.apply(POINTS_MM)
        shares.append(chdtr(9, chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, shared_mm)))
    assert np.mean(shares) == pytest.approx(0.5, abs=0.03)
    assert np.mean(np.array(shares) > 0.95) == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize("freedom", [None, 12.0])
def test_the_gate_refuses_as_often_as_stated_even_if_the_size_of_the_errors_is_an_estimate(
    freedom: float | None,
) -> None:
    generator = np.random.default_rng(5)
    shared_mm = generator.normal(0.0, 0.3, (5, 3, 2))
    refused = []
    for _ in range(2000):
        error_mm = generator.normal(0.0, SIGMA_MM, (5, 3)) + shared_mm @ generator.normal(size=2)
        estimated = 1.0 if freedom is None else generator.chisquare(freedom) / freedom
        allowed = AllowedErrors(COVARIANCE_MM2 * estimated, shared_mm * np.sqrt(estimated), freedom)
        fit = fit_rigid(POINTS_MM[None], POINTS_MM[None] + error_mm)
        mapped = POINTS_MM @ fit.rotation[0].T + fit.translation_mm[0]
        gate = gate_residuals(POINTS_MM + error_mm - mapped, mapped, allowed, 0.95)
        refused.append(not gate.passed)
    assert np.mean(refused) == pytest.approx(0.05, abs=0.015)


def test_allowed_errors_are_selected_sphere_by_sphere() -> None:
    allowed = AllowedErrors(COVARIANCE_MM2, np.arange(15.0).reshape(5, 3, 1), 80.0)[[0, 3]]
    np.testing.assert_array_equal(allowed.shared_mm[:, :, 0], [[0.0, 1.0, 2.0], [9.0, 10.0, 11.0]])
    assert (len(allowed.independent_mm2), allowed.freedom) == (2, 80.0)


TARGET_MM = np.array([10.0, 20.0, -60.0])
LIMIT = chi_square_limit(9, 0.999)


def _worst(points_mm: Array, largest_mm: float = 3.0) -> UnnoticedPoint:
    count = len(points_mm)
    gate = FreGate(0.0, 0.0, chi_square_limit(3 * count - 6, 0.999), 0.999)
    allowed = AllowedErrors(COVARIANCE_MM2[:count], np.zeros((count, 3, 1)))
    weights = np.linalg.inv(allowed.independent_mm2)
    return find_unnoticed_point(points_mm, TARGET_MM, allowed, weights, gate, largest_mm)


@pytest.mark.slow
@pytest.mark.parametrize(("directions", "draws"), [(600, 300), (3000, 1000)])
def test_the_worst_point_displaced_as_stated_shifts_the_target_as_stated_and_passes_every_other_time(
    directions: int, draws: int
) -> None:
    worst = _worst(POINTS_MM)
    generator = np.random.default_rng(3)
    found: list[tuple[float, Array]] = []
    passed = []
    for direction in generator.normal(size=(directions, 3)):
        displaced = POINTS_MM.copy()
        displaced[worst.index] += worst.displaced_mm * direction / np.linalg.norm(direction)
        fit = register(POINTS_MM, displaced, covariance_mm2=COVARIANCE_MM2)
        shift_mm = float(np.linalg.norm(fit.transform.apply(TARGET_MM) - TARGET_MM))
        found.append((shift_mm, displaced))
    shift_mm, displaced = max(found, key=lambda one: one[0])
    assert shift_mm == pytest.approx(worst.at_target_mm, rel=0.02)
    for _ in range(draws):
        error_mm = generator.normal(0.0, SIGMA_MM, (5, 3))
        fit = register(POINTS_MM, displaced + error_mm, covariance_mm2=COVARIANCE_MM2)
        mapped = fit.transform.apply(POINTS_MM)
        found_square = chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, np.zeros((5, 3, 1)))
        passed.append(found_square < LIMIT)
    assert np.mean(passed) == pytest.approx(0.5, abs=0.1)


def test_a_point_that_leaves_no_residual_is_held_by_the_largest_displacement_alone() -> None:
    worst = _worst(POINTS_MM[:3], 2.5)
    assert worst.displaced_mm == pytest.approx(2.5)
    assert worst.at_target_mm > 1.0


OWN = IndependentErrors("CT", COVARIANCE_MM2, NOTHING)
INSTRUMENT = IndependentErrors("instrument", np.zeros((5, 3, 3)), np.eye(3))


@pytest.mark.parametrize(("chi_square", "widening"), [(0.0, 1.0), (9.0, 1.0), (16.9, 1.0), (36.0, 2.0)])
def test_only_a_residual_too_large_widens_the_limit_by_its_ratio_and_nothing_else(
    chi_square: float, widening: float
) -> None:
    stated = predict_target_error(POINTS_MM, TARGET_MM, [OWN])
    tested = predict_target_error(POINTS_MM, TARGET_MM, [OWN], residual=ResidualCheck(chi_square, 9))
    assert tested.widening == pytest.approx(widening)
    assert tested.limit_mm() == pytest.approx(widening * stated.limit_mm())
    assert (tested.rms_mm, tested.budget_mm) == (stated.rms_mm, stated.budget_mm)


def test_what_displaces_the_target_alone_is_not_widened_since_no_residual_tests_it() -> None:
    alone = predict_target_error(POINTS_MM, TARGET_MM, [INSTRUMENT], residual=ResidualCheck(36.0, 9))
    assert alone.limit_mm() == predict_target_error(POINTS_MM, TARGET_MM, [INSTRUMENT]).limit_mm()
    both = predict_target_error(POINTS_MM, TARGET_MM, [OWN, INSTRUMENT], residual=ResidualCheck(36.0, 9))
    doubled = IndependentErrors("CT", 4.0 * COVARIANCE_MM2, NOTHING)
    wanted = predict_target_error(POINTS_MM, TARGET_MM, [doubled, INSTRUMENT])
    assert both.limit_mm() == pytest.approx(wanted.limit_mm())


def test_a_rare_source_counts_whole_in_the_rms_and_in_the_limit_as_often_as_it_is_there() -> None:
    at_target_mm2 = 4.0 * INSTRUMENT.at_target_mm2
    always, rarely = (
        predict_target_error(
            POINTS_MM, TARGET_MM, [OWN, replace(INSTRUMENT, at_target_mm2=at_target_mm2, rare=rare)]
        )
        for rare in (False, True)
    )
    never = predict_target_error(POINTS_MM, TARGET_MM, [OWN])
    assert (rarely.rms_mm, rarely.budget_mm) == (always.rms_mm, always.budget_mm)
    assert never.limit_mm() < rarely.limit_mm() < always.limit_mm()


@pytest.mark.slow
@pytest.mark.parametrize(("size", "least", "most"), [(1.0, 0.94, 0.98), (1.7, 0.90, 0.97)])
def test_the_limit_learns_that_errors_are_larger_than_stated(size: float, least: float, most: float) -> None:
    generator = np.random.default_rng(7)
    sources = [OWN, SharedErrors("arm", 0.1 * generator.normal(size=(5, 3, 2)), np.zeros((3, 2)))]
    inside, inside_stated = [], []
    for _ in range(500):
        common = sources[1].at_spheres_mm @ generator.normal(size=2)
        seen = POINTS_MM + size * (generator.normal(0.0, SIGMA_MM, (5, 3)) + common)
        fit = register(POINTS_MM, seen)
        residual = check_residuals(fit.residuals_mm, seen - fit.residuals_mm, sources)
        error_mm = float(np.linalg.norm(fit.transform.apply(TARGET_MM) - TARGET_MM))
        predicted = predict_target_error(POINTS_MM, TARGET_MM, sources, residual=residual)
        inside.append(error_mm <= predicted.limit_mm())
        inside_stated.append(error_mm <= predict_target_error(POINTS_MM, TARGET_MM, sources).limit_mm())
    assert least <= np.mean(inside) <= most
    assert np.mean(inside_stated) <= np.mean(inside)
    assert size == 1.0 or np.mean(inside_stated) < least
