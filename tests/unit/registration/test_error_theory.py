"""The error formulas against simulation, against each other, and against published numbers."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from procedures.registration import register
from procedures.registration.error_theory import (
    error_limit_mm,
    fle_from_fre_mm,
    fle_of_one_space_mm,
    fre_gate,
    fre_limit_mm,
    offset_limit_mm,
    pose_covariance,
    rare_limit_mm,
    target_covariance_mm2,
    tre_principal_axes_mm,
)
from procedures.registration.errors import RESIDUAL_TOO_LARGE, TOO_FEW_POINTS, BadParameter
from procedures.registration.rigid_fit import fit_rigid, residuals

FLE_MM = 0.3
RUNS = 20_000
TARGET = np.array([[0.0, 0.0, -10.0]])


@pytest.fixture(scope="module", params=[3, 4, 5, 8])
def simulated(request, fiducials):
    """Fiducials, squared FREs and target errors of many registrations with isotropic noise."""
    random = np.random.default_rng(20180)
    points = fiducials(request.param, random)
    measured = points + random.normal(size=(RUNS, *points.shape)) * FLE_MM / np.sqrt(3.0)
    fit = fit_rigid(np.broadcast_to(points, measured.shape), measured)
    squares = np.square(residuals(fit, points, measured)).sum(axis=2).mean(axis=1)
    error = np.einsum("nij,j->ni", fit.rotation, TARGET[0]) + fit.translation_mm - TARGET[0]
    return points, squares, np.linalg.norm(error, axis=1)


def test_fle_follows_from_fre_and_predicts_the_target_error_within_two_percent(simulated):
    points, squares, error = simulated
    assert fle_from_fre_mm(np.sqrt(squares.mean()), len(points)) == pytest.approx(FLE_MM, rel=0.02)
    predicted = tre_principal_axes_mm(TARGET, points, FLE_MM)[0]
    assert predicted == pytest.approx(np.sqrt(np.square(error).mean()), rel=0.02)


def test_the_stated_limit_contains_the_stated_share_of_errors(simulated):
    points, _, error = simulated
    pose = pose_covariance(points, np.tile(np.eye(3) * FLE_MM**2 / 3, (len(points), 1, 1)), weighted=False)
    limit = error_limit_mm(target_covariance_mm2(TARGET, points, pose), 0.95)[0]
    assert np.mean(error < limit) == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("probability", [0.0, 0.1, 0.4, 1.0])
def test_the_limit_with_a_rare_part_contains_the_stated_share(
    random: np.random.Generator, probability: float
) -> None:
    usual_mm2, rare_mm2 = np.diag([0.02, 0.01, 0.01]), np.diag([0.2, 0.02, 0.05])
    there = random.random(200_000) < probability
    errors_mm = random.standard_normal((len(there), 3)) * np.sqrt(np.diag(usual_mm2))
    errors_mm += there[:, None] * random.standard_normal((len(there), 3)) * np.sqrt(np.diag(rare_mm2))
    limit_mm = rare_limit_mm(usual_mm2, rare_mm2, probability, 0.95)
    assert np.mean(np.linalg.norm(errors_mm, axis=1) < limit_mm) == pytest.approx(0.95, abs=0.005)


def test_a_rare_part_too_small_to_matter_leaves_the_limit() -> None:
    usual_mm2 = np.diag([0.02, 0.01, 0.01])
    limit_mm = rare_limit_mm(usual_mm2, 1e-17 * usual_mm2, 0.4)
    assert limit_mm == pytest.approx(error_limit_mm(usual_mm2, 0.95))


def test_the_gate_rejects_five_percent_of_sound_registrations(simulated):
    points, squares, _ = simulated
    limit_mm = fre_limit_mm(FLE_MM, len(points))
    assert np.mean(np.sqrt(squares) > limit_mm) == pytest.approx(0.05, abs=0.01)


@pytest.mark.hazard(28)
def test_fre_is_uncorrelated_with_the_target_error(simulated):
    _, squares, error = simulated
    assert abs(np.corrcoef(np.sqrt(squares), error)[0, 1]) < 0.05


def test_principal_axes_and_covariance_propagation_agree(random, fiducials):
    points, targets = fiducials(5, random), random.normal(size=(20, 3)) * 60.0
    isotropic = np.tile(np.eye(3) * FLE_MM**2 / 3.0, (5, 1, 1))
    for weighted in (False, True):
        covariance = target_covariance_mm2(
            targets, points, pose_covariance(points, isotropic, weighted=weighted)
        )
        propagated = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        assert np.allclose(propagated, tre_principal_axes_mm(targets, points, FLE_MM), rtol=1e-9)


def test_unequal_errors_propagate_through_plain_least_squares(random, fiducials):
    points = fiducials(5, random)
    spread = np.array([0.1, 0.2, 0.3, 0.2, 0.8])[:, None] * np.array([1.0, 1.0, 3.0])
    measured = points + random.normal(size=(RUNS, 5, 3)) * spread
    fit = fit_rigid(np.broadcast_to(points, measured.shape), measured)
    error = np.einsum("nij,j->ni", fit.rotation, TARGET[0]) + fit.translation_mm - TARGET[0]
    pose = pose_covariance(points, np.eye(3) * spread[:, None, :] ** 2, weighted=False)
    predicted = target_covariance_mm2(TARGET, points, pose)[0]
    assert np.allclose(np.cov(error.T), predicted, atol=0.04 * np.trace(predicted))


def test_gate_limits_are_the_known_multiples_of_fle():
    limits = [fre_limit_mm(1.0, count) for count in (3, 4, 5, 6, 8)]
    assert np.round(limits, 2).tolist() == [0.93, 1.02, 1.06, 1.08, 1.10]


def test_the_gate_passes_small_residuals_and_refuses_large_ones():
    fre_gate(0.2, 0.3, 5).require()
    gate = fre_gate(0.5, 0.3, 5)
    assert not gate.passed
    assert gate.limit_mm == pytest.approx(fre_limit_mm(0.3, 5))
    with raises(RESIDUAL_TOO_LARGE, match=r"REG-010.*0\.500 mm"):
        gate.require()


def test_fle_of_two_equal_spaces_follows_from_ten_fre_within_two_percent(random, fiducials):
    """Eq. 37 and 38 as table 3 uses them: two scans of one kind, four fiducials, ten registrations."""
    points, registrations, tables_drawn = fiducials(4, random), 10, RUNS // 4
    scans = points + random.normal(size=(2, tables_drawn * registrations, 4, 3)) * FLE_MM / np.sqrt(3.0)
    fit = fit_rigid(scans[0], scans[1])
    fre_mm = np.sqrt(np.square(residuals(fit, scans[0], scans[1])).sum(axis=2).mean(axis=1))
    tables = [fle_of_one_space_mm(ten, 4) for ten in fre_mm.reshape(tables_drawn, registrations)]
    assert np.sqrt(np.mean(np.square(tables))) == pytest.approx(FLE_MM, rel=0.02)
    both = fle_from_fre_mm(np.sqrt(np.mean(np.square(fre_mm))), 4)
    assert both == pytest.approx(np.sqrt(2.0) * FLE_MM, rel=0.02)


def test_two_points_have_no_residual_freedom():
    with raises(TOO_FEW_POINTS, match="REG-002"):
        fle_from_fre_mm(0.1, 2)


@pytest.mark.parametrize(
    "call",
    [
        lambda: fre_limit_mm(0.0, 4),
        lambda: fre_limit_mm(0.3, 4, 1.0),
        lambda: fre_gate(float("nan"), 0.3, 4),
        lambda: fle_from_fre_mm(float("nan"), 4),
        lambda: fle_from_fre_mm(-0.1, 4),
        lambda: fle_from_fre_mm("0.1", 4),
        lambda: fle_of_one_space_mm([], 4),
        lambda: fle_of_one_space_mm([0.1, float("nan")], 4),
        lambda: fle_of_one_space_mm([0.1, -0.1], 4),
    ],
)
def test_impossible_parameters_are_refused(call):
    with pytest.raises(BadParameter, match="REG-007"):
        call()


def test_an_estimated_error_widens_the_limit(random, fiducials):
    points = fiducials(4, random)
    found = register(points, points + random.normal(size=points.shape) * 0.2)
    estimated = found.predict_tre(TARGET)
    known = found.predict_tre(TARGET, fle_mm=found.fle_mm)
    assert estimated.rms_mm == pytest.approx(known.rms_mm)
    assert estimated.limit_mm[0] > known.limit_mm[0] > known.rms_mm[0]
    assert "eq. 39" in estimated.formula


def test_the_limit_from_an_estimated_error_contains_the_stated_share_of_errors(simulated):
    """FLE is known from the same few residuals only; the limit must be honest about that too."""
    points, squares, error = simulated
    pose = pose_covariance(points, np.tile(np.eye(3) / 3.0, (len(points), 1, 1)), weighted=False)
    unit_limit = error_limit_mm(target_covariance_mm2(TARGET, points, pose), 0.95, 3 * len(points) - 6)[0]
    estimated_fle_mm = np.sqrt(squares * len(points) / (len(points) - 2))
    assert np.mean(error < unit_limit * estimated_fle_mm) == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("offset_mm", [(0.0, 0.0), (0.4, 0.0), (0.1, -0.3), (1.0, 1.0)])
@pytest.mark.parametrize("errors_mm", [(0.2, 0.2), (0.2, 0.05), (0.05, 0.2)])
def test_the_limit_of_an_offset_contains_the_stated_share_of_its_draws(random, offset_mm, errors_mm):
    covariance_mm2 = np.diag(np.square(errors_mm))
    limit_mm = offset_limit_mm(np.array(offset_mm), covariance_mm2, 0.95)
    drawn_mm = random.multivariate_normal(offset_mm, covariance_mm2, 20_000)
    assert np.mean(np.linalg.norm(drawn_mm, axis=1) <= limit_mm) == pytest.approx(0.95, abs=0.01)


def test_the_prediction_from_covariances_matches_the_errors(random, fiducials):
    points, target = fiducials(5, random), np.array([10.0, 20.0, -30.0])
    spread = np.array([0.1, 0.1, 0.4])
    covariance = np.tile(np.diag(spread**2), (5, 1, 1))
    errors = []
    for _ in range(300):
        measured = points + random.normal(size=points.shape) * spread
        found = register(points, measured, covariance_mm2=covariance)
        errors.append(np.linalg.norm(found.transform.apply(target) - target))
    predicted = found.predict_tre(target)
    assert predicted.rms_mm[0] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.1)
    assert np.mean(np.array(errors) < predicted.limit_mm[0]) == pytest.approx(0.95, abs=0.03)


def test_a_prediction_takes_one_point_or_many(random, fiducials):
    points = fiducials(4, random)
    found = register(points, points + random.normal(size=points.shape) * 0.2)
    assert found.predict_tre_mm([0.0, 0.0, 0.0]).shape == (1,)
    assert found.predict_tre_mm(points).shape == (4,)
    assert found.predict_tre_mm(np.zeros((0, 3))).shape == (0,)
