"""The factory's calibration: what it knows of a true arm, and that the driver's kinematics understand it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UR5E
from ronna_hw.vectors import joint_vector
from sim.universal_robots import factory_calibration
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.kinematics import TrueKinematics
from sim.universal_robots.model import MODELS
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm

POSTURES = np.random.default_rng(5).uniform(-2.0, 2.0, (50, 6))
NO_FLANK = (0.0,) * 6


@cache
def scene_of(arm: str) -> Scene:
    return draw_scene("bench", seed=3, arm=ArmChoice(arm))


def chain(arm: str, kind: factory_calibration.FactoryCalibration) -> TrueKinematics:
    scene = scene_of(arm)
    return calibrate(MODELS[arm], scene.arm, scene.seed, kind)


def error_mm(arm: str, kinematics: TrueKinematics) -> float:
    """Mean distance of the true flange from where the controller computes it."""
    true = TrueArm(scene_of(arm).arm, scene_of(arm).seed)
    return float(
        np.mean(
            [
                np.linalg.norm(true.moving(q, NO_FLANK)[:3, 3] - 1000.0 * np.array(kinematics.flange(q)[9:]))
                for q in POSTURES.tolist()
            ]
        )
    )


@pytest.mark.parametrize("arm", MODELS)
@pytest.mark.parametrize("kind", ["linearised", "exact"])
def test_a_calibrated_arm_errs_less_than_half_as_much_but_still_errs(
    arm: str, kind: factory_calibration.FactoryCalibration
) -> None:
    nominal = error_mm(arm, chain(arm, "none"))
    assert 0.1 < error_mm(arm, chain(arm, kind)) < 0.5 * nominal


def test_exact_parameters_lie_metres_away_and_the_driver_finds_the_same_arm_in_them() -> None:
    ours = chain("ur5e", "exact")
    assert max(map(abs, ours.d_m)) > 5.0
    arm = DIMENSIONS[UR5E]
    columns = (ours.theta_rad, *(map((1000.0).__mul__, m) for m in (ours.a_m, ours.d_m)), ours.alpha_rad)
    stated = FactoryCalibration.from_parameters(arm, *map(joint_vector, columns))
    theirs = CalibratedUniversalRobot(arm, stated)
    for joints in POSTURES.tolist():
        pose = theirs.forward(joint_vector(joints))
        assert [1000.0 * x for x in ours.flange(joints)[9:]] == pytest.approx(pose.position_mm, abs=1e-6)


def test_linearised_parameters_are_small_changes() -> None:
    ours, nominal = chain("ur5", "linearised"), chain("ur5", "none")
    for mine, theirs, small in (
        (ours.d_m, nominal.d_m, 0.005),
        (ours.a_m, nominal.a_m, 0.005),
        (ours.theta_rad, nominal.theta_rad, 0.01),
        (ours.alpha_rad, nominal.alpha_rad, 0.01),
    ):
        assert list(mine) == pytest.approx(list(theirs), abs=small)
