"""The factory's kinematic calibration of a true arm: 24 Denavit-Hartenberg parameters fitted to its poses.

What those parameters cannot describe remains: harmonics, sag, lost motion, and two errors at the flange.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import ALPHA_RAD, DIMENSIONS, Dimensions, UrModel
from ronna_hw.vectors import joint_vector
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import TrueArm

Array = NDArray[np.float64]

POSES = 120
SPREAD_RAD = math.radians(60.0)  # of every joint about home, either way
FACTORY_MM = 0.05  # error of the factory's measurement, per axis (U)
ROUNDS = 4
STEP = 1e-5
LEVER_MM = 300.0  # a radian of orientation counts as this distance
# Prior of a difference: with it the nearly parallel axes do not send d2 and d3 hundreds of metres away.
PRIOR_RAD, PRIOR_MM = 0.01, 3.0
JOINTS = 6
FACTORY_KEY = 7  # of the random numbers


def calibrate_in_factory(truth: ArmTruth, seed: int) -> CalibratedUniversalRobot:
    """Return the kinematics that the arm's controller states, identified from measured poses."""
    arm, true = DIMENSIONS[UrModel(truth.variant)], TrueArm(truth, seed)
    random = np.random.default_rng([seed, FACTORY_KEY])
    joints = np.radians(truth.home_deg) + random.uniform(-SPREAD_RAD, SPREAD_RAD, (POSES, JOINTS))
    measured = np.array(
        [true.at_rest(row, (0.0,) * JOINTS, number) for number, row in enumerate(joints.tolist())]
    )
    measured[:, :3, 3] += random.normal(0.0, FACTORY_MM, (POSES, 3))
    scale = np.repeat([PRIOR_RAD, PRIOR_MM, PRIOR_MM, PRIOR_RAD], JOINTS)
    values = np.zeros(4 * JOINTS)  # in units of the prior
    for _ in range(ROUNDS):
        misses = _misses(arm, values * scale, joints, measured)
        slopes = np.stack(
            [
                (_misses(arm, (values + step) * scale, joints, measured) - misses) / STEP
                for step in STEP * np.eye(len(values))
            ],
            axis=1,
        )
        weighted = slopes / FACTORY_MM
        normal = weighted.T @ weighted + np.eye(len(values))
        values -= np.linalg.solve(normal, weighted.T @ misses / FACTORY_MM + values)
    theta, a, d, alpha = (values * scale).reshape(4, JOINTS)
    return CalibratedUniversalRobot(
        arm, FactoryCalibration(joint_vector(theta), joint_vector(a), joint_vector(d), joint_vector(alpha))
    )


def _misses(arm: Dimensions, differences: Array, joints_rad: Array, measured: Array) -> Array:
    """Return the differences of computed and measured poses, (n,) mm."""
    poses = _flange_poses(arm, differences, joints_rad)
    turned = Rotation.from_matrix(poses[:, :3, :3] @ measured[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
    return np.concatenate([(poses - measured)[:, :3, 3], LEVER_MM * turned], axis=1).ravel()


def _flange_poses(arm: Dimensions, differences: Array, joints_rad: Array) -> Array:
    """Return the poses (m, 4, 4) of the flange by Denavit-Hartenberg parameters, at joints (m, 6)."""
    theta, a, d, alpha = differences.reshape(4, JOINTS)
    poses = np.tile(np.eye(4), (len(joints_rad), 1, 1))
    for joint, nominal in enumerate(arm.links):
        ca, sa = math.cos(ALPHA_RAD[joint] + alpha[joint]), math.sin(ALPHA_RAD[joint] + alpha[joint])
        along, up = nominal.position_mm[0] + a[joint], nominal.position_mm[2] + d[joint]
        c, s = np.cos(joints_rad[:, joint] + theta[joint]), np.sin(joints_rad[:, joint] + theta[joint])
        zero, one = np.zeros_like(c), np.ones_like(c)
        step = np.array(
            [
                [c, -s * ca, s * sa, along * c],
                [s, c * ca, -c * sa, along * s],
                [zero, sa * one, ca * one, up * one],
                [zero, zero, zero, one],
            ]
        )
        poses = poses @ step.transpose(2, 0, 1)
    return poses
