"""The controller's kinematics, nominal and of the factory's calibration, against those of the drivers."""

from __future__ import annotations

from functools import cache
from math import pi

import numpy as np
import pytest

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UR5E
from ronna_hw.vectors import joint_vector
from sim.universal_robots import factory_calibration
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.kinematics import (
    TrueKinematics,
    frame_of_pose,
    pose_of_frame,
    rotation_vector,
)
from sim.universal_robots.model import MODELS
from sim.world.scene.arm_design import DESIGNS
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm

POSTURES = np.random.default_rng(4).uniform(-pi, pi, (50, 6)).tolist()


@pytest.mark.parametrize("arm", MODELS)
def test_the_flange_is_where_the_drivers_have_it(arm: str) -> None:
    ours, theirs = TrueKinematics(MODELS[arm]), universal_robot(arm)
    for joints in POSTURES:
        frame, pose = ours.flange(joints), theirs.forward(joint_vector(joints))
        assert [1000.0 * value for value in frame[9:]] == pytest.approx(pose.position_mm, abs=1e-9)
        assert frame[:9] == pytest.approx(pose.rotation, abs=1e-12)


def test_an_arm_with_nearly_parallel_axes_and_huge_lengths_is_the_drivers_too() -> None:
    model = MODELS["ur5e"]
    theta = (1e-4, 0.0021, 0.0, -0.0021, 0.0, 0.0)
    d = (1e-4, 439.0, -446.0, 7.0, 0.0, 0.0)
    alpha = (1e-4, 2e-7, -3e-7, 1e-4, 0.0, 0.0)
    deltas = FactoryCalibration(
        joint_vector(theta), d_mm=joint_vector(1000.0 * x for x in d), alpha_rad=joint_vector(alpha)
    )
    ours = TrueKinematics(model, theta_rad=theta, d_m=d, alpha_rad=alpha)
    theirs = CalibratedUniversalRobot(universal_robot("ur5e").dimensions, deltas)
    for joints in POSTURES:
        pose = theirs.forward(joint_vector(joints))
        assert [1000.0 * x for x in ours.flange(joints)[9:]] == pytest.approx(pose.position_mm, abs=1e-6)


def test_joints_near_a_posture_are_found_again() -> None:
    ours = TrueKinematics(MODELS["ur5"])
    for joints in POSTURES[:20]:
        found = ours.joints_at(ours.flange(joints), [angle + 0.05 for angle in joints])
        assert found is not None
        assert list(ours.flange(found)) == pytest.approx(list(ours.flange(joints)), abs=1e-8)


@pytest.mark.parametrize(
    "vector",
    [
        (0.0, 0.0, 0.0),
        (1e-9, 0.0, 0.0),
        (0.5, -1.0, 2.0),
        (0.0, pi, 0.0),
        (pi / 2, pi / 2, pi / 2),
        (3.1415926, 0, 0),
    ],
)
def test_a_rotation_vector_survives_its_matrix(vector: tuple[float, float, float]) -> None:
    frame = frame_of_pose((0.1, 0.2, 0.3, *vector))
    again = frame_of_pose(pose_of_frame(frame))
    assert list(again) == pytest.approx(list(frame), abs=1e-9)
    assert np.linalg.norm(rotation_vector(frame)) <= pi + 1e-12


MODERATE_POSTURES = np.random.default_rng(5).uniform(-2.0, 2.0, (50, 6))
NO_FLANK = (0.0,) * 6


@cache
def scene_of(arm: str) -> Scene:
    drawn = draw_scene("bench", seed=3, arm=DESIGNS[arm].choice or ArmChoice.UR5E)
    return drawn.model_copy(update={"arm": drawn.arm.model_copy(update={"variant": arm})})


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
                for q in MODERATE_POSTURES.tolist()
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
    for joints in MODERATE_POSTURES.tolist():
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
