"""The error predicted while a plan is drawn, against independent formulas and random draws."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from half_sitting import SIGHT
from numpy.typing import NDArray
from prepared_results import deformation
from scipy.spatial.transform import Rotation
from strategy_arms import LEANING

from procedures.calibration.arm_model import ArmModel
from procedures.calibration.arm_sources import REPEATABILITY_MM
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.target_error import (
    USUAL_SEATING_MM,
    choose_best_strategies,
    predict_arm_error_mm,
    predict_by_markers,
)
from procedures.planning.visits import ArmSetting, PathCheck
from procedures.registration.error_sources import FUSION, SCAN
from procedures.registration.error_theory import tre_principal_axes_mm
from procedures.registration.rigid_fit import fit_rigid
from procedures.strategies.catalogue import CANDIDATES, BestOfEach, find_strategy
from procedures.strategies.strategy import Strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses
from ronna_hw.calibrated_arm.error_budget import ErrorSizes

MARKERS_MM = np.array([[60.0, -40.0, 60.0], [-50.0, -45.0, 55.0], [5.0, 40.0, 80.0], [-60.0, 20.0, 70.0]])
TARGET_MM = (5.0, -20.0, 20.0)


def by_markers_alone_mm(covariances: NDArray[np.float64]) -> float:
    """Error at the target without that of the scan as a whole."""
    predicted = predict_by_markers(MARKERS_MM, covariances, TARGET_MM)
    return math.sqrt(predicted.rms_mm**2 - predicted.budget_mm[SCAN] ** 2)


def test_equal_markers_give_the_error_of_fitzpatricks_formula() -> None:
    own_mm = 0.1  # 3-D rms
    covariances = np.tile(np.eye(3) * own_mm**2 / 3.0, (4, 1, 1))
    fle_mm = float(np.sqrt(own_mm**2 + 3.0 * USUAL_SEATING_MM**2))
    (by_formula,) = tre_principal_axes_mm(np.array([TARGET_MM]), MARKERS_MM, fle_mm)
    assert by_markers_alone_mm(covariances) == pytest.approx(by_formula, rel=1e-6)


def test_unequal_markers_give_the_error_of_many_random_draws() -> None:
    random = np.random.default_rng(5)
    covariances = np.stack([np.diag(random.uniform(0.001, 0.09, 3)) for _ in MARKERS_MM])
    seated = covariances + np.eye(3) * USUAL_SEATING_MM**2
    roots = np.linalg.cholesky(seated)
    errors = []
    middle = MARKERS_MM.mean(axis=0)
    for _ in range(2000):
        moved = MARKERS_MM + np.einsum("nij,nj->ni", roots, random.standard_normal((4, 3)))
        turn, _ = Rotation.align_vectors(moved - moved.mean(axis=0), MARKERS_MM - middle)
        errors.append(turn.apply(np.array(TARGET_MM) - middle) + moved.mean(axis=0) - TARGET_MM)
    drawn_mm = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    assert by_markers_alone_mm(covariances) == pytest.approx(drawn_mm, rel=0.06)


def test_a_scan_left_open_adds_what_its_lever_makes_of_it_at_the_target() -> None:
    covariances = np.tile(np.eye(3) * 0.01, (4, 1, 1))
    far_mm = (5.0, -20.0, -120.0)
    added = {
        (target, sigma): predict_by_markers(MARKERS_MM, covariances, target, deformation(sigma)).budget_mm[
            SCAN
        ]
        for target in (TARGET_MM, far_mm)
        for sigma in (3e-4, 1e-9)
    }
    assert added[far_mm, 3e-4] > 2.0 * added[TARGET_MM, 3e-4] > 2.0 * added[TARGET_MM, 1e-9]
    unseen = predict_by_markers(MARKERS_MM, covariances, TARGET_MM).budget_mm[SCAN]
    assert unseen > added[TARGET_MM, 3e-4]


FIDUCIALS = np.array([[60.0, -70.0, 60.0], [-50.0, -75.0, 55.0], [5.0, -40.0, 100.0], [30.0, -90.0, 20.0]])
DRAWS = 400  # their rms is known to 4 %


@pytest.mark.parametrize(
    ("sizes", "candidates"),
    [
        pytest.param(ErrorSizes(), CANDIDATES, marks=pytest.mark.slow, id="all"),
        pytest.param(ErrorSizes(links=0.0, joints=0.0), CANDIDATES, marks=pytest.mark.slow, id="tool"),
        pytest.param(ErrorSizes(links=0.0, joints=0.0), CANDIDATES[-2:], id="tool, of two"),
    ],
)
def test_the_strategy_with_the_least_predicted_error_is_chosen(
    make_arm: Callable[..., ArmSetting],
    monkeypatch: pytest.MonkeyPatch,
    sizes: ErrorSizes,
    candidates: tuple[Strategy, ...],
) -> None:
    monkeypatch.setattr("procedures.planning.target_error.CANDIDATES", candidates)
    setting = make_arm(strategy=find_strategy("best"), sizes=sizes)
    chosen = choose_best_strategies(setting, [LEANING], FIDUCIALS, SIGHT).strategy
    assert isinstance(chosen, BestOfEach)
    predicted_mm = {}
    for one in candidates:
        alone = replace(setting, strategy=one)
        check = choose_free_angles(alone, [LEANING], FIDUCIALS, SIGHT).check
        predicted_mm[one.name] = predict_arm_error_mm(alone, check, LEANING)
    assert chosen.strategy_for("T1").name == min(predicted_mm, key=lambda name: predicted_mm[name])


@pytest.mark.slow
def test_the_predicted_error_is_that_of_drawn_arms_at_the_target_not_at_the_holding_pose(
    make_arm: Callable[..., ArmSetting],
) -> None:
    with_rest = LEANING.with_rest(-90.0)
    setting = make_arm(sizes=ErrorSizes(tool_mm=0.0, backlash=0.0))
    check = choose_free_angles(setting, [with_rest], FIDUCIALS, SIGHT).check
    errors_mm = np.array([_error_of_a_drawn_arm_mm(setting, check, with_rest, draw) for draw in range(DRAWS)])
    rms_mm = np.sqrt(np.mean(np.sum(errors_mm**2, axis=1)))
    assert predict_arm_error_mm(setting, check, with_rest) == pytest.approx(rms_mm, rel=0.1)


def _error_of_a_drawn_arm_mm(
    setting: ArmSetting, check: PathCheck, with_rest: Trajectory, draw: int
) -> NDArray[np.float64]:
    """Where an arm of set S brings the tip beside the target, by its nominal twin's poses."""
    generator, chain = np.random.default_rng(draw), setting.kinematics.chain
    sigmas = ArmModel(setting.kinematics, setting.flange_from_tool).prior
    drawn = ArmDeviations.from_flat(sigmas * generator.normal(size=len(sigmas)), len(chain.joints))
    points = np.concatenate(
        [setting.robot_from_ct.apply(FIDUCIALS), [setting.robot_from_ct.apply(with_rest.target_mm)]]
    )
    off = np.zeros_like(points)
    for row, (one, point) in enumerate(zip(check.reached, points, strict=True)):
        nominal = setting.kinematics.flange_pose(one.at_rad)
        true = flange_poses(chain, drawn, [one.at_rad])[0]
        off[row] = true[:3, :3] @ nominal.inverse().apply(point) + true[:3, 3] - point
    off += generator.normal(0.0, REPEATABILITY_MM, off.shape)
    fit = fit_rigid(points[:-1], points[:-1] - off[:-1])
    reached: NDArray[np.float64] = fit.rotation @ points[-1] + fit.translation_mm + off[-1]
    return reached - points[-1]


def test_a_fixed_strategy_stays_unchanged(make_arm: Callable[..., ArmSetting]) -> None:
    setting = make_arm()
    assert choose_best_strategies(setting, [LEANING], FIDUCIALS, SIGHT) is setting


def test_a_target_chosen_by_a_fusion_bears_its_error() -> None:
    covariances = np.tile(np.eye(3) * 0.01, (4, 1, 1))
    in_ct = predict_by_markers(MARKERS_MM, covariances, TARGET_MM)
    fused = predict_by_markers(MARKERS_MM, covariances, TARGET_MM, fusion_error_mm=0.4)
    assert FUSION not in in_ct.budget_mm
    assert fused.budget_mm[FUSION] == pytest.approx(0.4)
    assert fused.rms_mm == pytest.approx(math.hypot(in_ct.rms_mm, 0.4))
