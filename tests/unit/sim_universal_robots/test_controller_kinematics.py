"""The controller's kinematics against those of the drivers, which are written independently."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.vectors import joint_vector
from sim.universal_robots.kinematics import (
    TrueKinematics,
    frame_of_pose,
    pose_of_frame,
    rotation_vector,
)
from sim.universal_robots.model import MODELS

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
