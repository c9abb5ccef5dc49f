"""The strategy `best` is decided for each trajectory by the error predicted for its poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from procedures.calibration.arm_sources import ErrorSizes
from procedures.planning.best_choice import predicted_arm_error_mm, with_best_chosen
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.sight import StereoSight
from procedures.planning.visits import ArmSetting
from procedures.strategies.best import CANDIDATES, BestOfEach
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.trajectory import Trajectory

FIDUCIALS = np.array([[60.0, -70.0, 60.0], [-50.0, -75.0, 55.0], [5.0, -40.0, 100.0], [30.0, -90.0, 20.0]])
CAMERA_MM = np.array([0.0, 115.0, -222.0])
SIGHT = StereoSight(left_mm=CAMERA_MM * (1.0, -1.0, 1.0), right_mm=CAMERA_MM)
LEANING = Trajectory("T1", (10.0, -80.0, 60.0), (5.0, -20.0, 20.0))


@pytest.mark.parametrize("sizes", [ErrorSizes(), ErrorSizes(links=0.0, joints=0.0)], ids=["all", "tool"])
def test_the_strategy_with_the_least_predicted_error_is_chosen(
    make_arm: Callable[..., ArmSetting], sizes: ErrorSizes
) -> None:
    setting = make_arm(strategy=strategy_named("best"), sizes=sizes)
    chosen = with_best_chosen(setting, [LEANING], FIDUCIALS, SIGHT).strategy
    assert isinstance(chosen, BestOfEach)
    predicted_mm = {}
    for one in CANDIDATES:
        alone = replace(setting, strategy=one)
        check = choose_free_angles(alone, [LEANING], FIDUCIALS, SIGHT).check
        predicted_mm[one.name] = predicted_arm_error_mm(alone, check)
    assert chosen.of("T1").name == min(predicted_mm, key=lambda name: predicted_mm[name])


def test_another_strategy_stays_as_it_is(make_arm: Callable[..., ArmSetting]) -> None:
    setting = make_arm()
    assert with_best_chosen(setting, [LEANING], FIDUCIALS, SIGHT) is setting
