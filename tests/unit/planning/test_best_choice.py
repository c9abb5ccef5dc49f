"""The strategy `best` picks, for each trajectory, the strategy with the least predicted error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.calibration.arm.error_model import ArmModel
from procedures.calibration.arm_sources import REPEATABILITY_MM, ErrorSizes
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.target_error import choose_best_strategies, predicted_arm_error_mm
from procedures.planning.visits import ArmSetting, PathCheck
from procedures.registration.rigid_fit import fit_rigid
from procedures.strategies.best import CANDIDATES, BestOfEach
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.deviations import ArmDeviations, flange_poses

FIDUCIALS = np.array([[60.0, -70.0, 60.0], [-50.0, -75.0, 55.0], [5.0, -40.0, 100.0], [30.0, -90.0, 20.0]])
CAMERA_MM = np.array([0.0, 115.0, -222.0])
SIGHT = StereoSight(left_mm=CAMERA_MM * (1.0, -1.0, 1.0), right_mm=CAMERA_MM)
DRAWS = 400  # their rms is known to 4 %
LEANING = Trajectory("T1", (10.0, -80.0, 60.0), (5.0, -20.0, 20.0))


@pytest.mark.parametrize("sizes", [ErrorSizes(), ErrorSizes(links=0.0, joints=0.0)], ids=["all", "tool"])
def test_the_strategy_with_the_least_predicted_error_is_chosen(
    make_arm: Callable[..., ArmSetting], sizes: ErrorSizes
) -> None:
    setting = make_arm(strategy=strategy_named("best"), sizes=sizes)
    chosen = choose_best_strategies(setting, [LEANING], FIDUCIALS, SIGHT).strategy
    assert isinstance(chosen, BestOfEach)
    predicted_mm = {}
    for one in CANDIDATES:
        alone = replace(setting, strategy=one)
        check = choose_free_angles(alone, [LEANING], FIDUCIALS, SIGHT).check
        predicted_mm[one.name] = predicted_arm_error_mm(alone, check, LEANING)
    assert chosen.of("T1").name == min(predicted_mm, key=lambda name: predicted_mm[name])


def test_the_predicted_error_is_that_of_drawn_arms_at_the_target_not_at_the_holding_pose(
    make_arm: Callable[..., ArmSetting],
) -> None:
    held = LEANING.held(-90.0)
    setting = make_arm(sizes=ErrorSizes(tool_mm=0.0, backlash=0.0))
    check = choose_free_angles(setting, [held], FIDUCIALS, SIGHT).check
    errors_mm = np.array([_error_of_a_drawn_arm_mm(setting, check, held, draw) for draw in range(DRAWS)])
    rms_mm = np.sqrt(np.mean(np.sum(errors_mm**2, axis=1)))
    assert predicted_arm_error_mm(setting, check, held) == pytest.approx(rms_mm, rel=0.1)


def _error_of_a_drawn_arm_mm(
    setting: ArmSetting, check: PathCheck, held: Trajectory, draw: int
) -> NDArray[np.float64]:
    """Where an arm of set S brings the tip beside the target, by its nominal twin's poses."""
    generator, chain = np.random.default_rng(draw), setting.kinematics.chain
    sigmas = ArmModel(setting.kinematics, setting.flange_from_tool).prior
    drawn = ArmDeviations.of_flat(sigmas * generator.normal(size=len(sigmas)), len(chain.joints))
    points = np.concatenate(
        [setting.robot_from_ct.apply(FIDUCIALS), [setting.robot_from_ct.apply(held.target_mm)]]
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
