"""The factory's calibration: the individual arm behind the neutral interface, whatever describes it.

Between two nearly parallel axes the common normal lies where they happen to come closest, possibly hundreds
of metres away: an arm without visible error may have such parameters.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from math import atan2, pi
from typing import NamedTuple

import numpy as np
import pytest
from coded_errors import raises
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.arm.errors import CALIBRATION_OF_ANOTHER_ARM, Singular, Unreachable
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import ZEROS, FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import ALPHA_RAD, DIMENSIONS, UR5, UR5E
from ronna_hw.arm.universal_robots.kinematics import universal_robot
from ronna_hw.vectors import JointVector, joint_vector

Matrix = NDArray[np.float64]

PARALLEL = 1e-12  # sine between two axes below which any normal is common


class Row(NamedTuple):
    """Parameters of a joint: Rz(theta + q) Tz(d) Tx(a) Rx(alpha)."""

    theta_rad: float
    d_mm: float
    a_mm: float
    alpha_rad: float


def rows_of_axes(axes: Sequence[tuple[Matrix, Matrix]], flange: Matrix) -> list[Row]:
    """Return the parameters of the joints whose axes are (point mm, direction) in the base at joint zero.

    The first axis is the base's z. The last row has no a and no alpha: it places `flange` (4, 4) along and
    about the last axis only, as far as a row can.
    """
    rows = []
    point, z, x = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    for other, direction in axes[1:]:
        across = np.cross(z, direction)
        sine = float(np.linalg.norm(across))
        gap = other - point
        if sine < PARALLEL:
            d = 0.0
            across = gap - (gap @ z) * z
        else:
            d = float(np.cross(gap, direction) @ across) / sine**2
        normal = across / np.linalg.norm(across)
        if normal @ x < 0.0 and sine >= PARALLEL:
            normal = -normal
        foot = point + d * z
        a = float((other - foot) @ normal)
        theta = atan2(float(np.cross(x, normal) @ z), float(x @ normal))
        alpha = atan2(float(np.cross(z, direction) @ normal), float(z @ direction))
        rows.append(Row(theta, d, a, alpha))
        point, z, x = foot + a * normal, direction, normal
    d = float((flange[:3, 3] - point) @ z)
    theta = atan2(float(np.cross(x, flange[:3, 0]) @ z), float(x @ flange[:3, 0]))
    return [*rows, Row(theta, d, 0.0, 0.0)]


each_model = pytest.mark.parametrize("model", [UR5, UR5E])


def random_calibration(rng: random.Random) -> FactoryCalibration:
    def six(size: float) -> JointVector:
        return joint_vector(rng.uniform(-size, size) for _ in range(6))

    return FactoryCalibration(six(2e-3), six(1.0), six(1.0), six(1e-3))


def random_joints(rng: random.Random) -> JointVector:
    return joint_vector(rng.uniform(-pi, pi) for _ in range(6))


@each_model
def test_no_difference_is_the_nominal_arm(model: str) -> None:
    calibrated = CalibratedUniversalRobot(DIMENSIONS[model], FactoryCalibration())
    joints = random_joints(random.Random(1))
    assert calibrated.forward(joints).distance_mm(universal_robot(model).forward(joints)) < 1e-9


@each_model
def test_the_inverse_of_any_calibration_is_exact_in_every_branch(model: str) -> None:
    rng = random.Random(2)
    for _ in range(20):
        arm = CalibratedUniversalRobot(DIMENSIONS[model], random_calibration(rng))
        for _ in range(4):
            joints = random_joints(rng)
            if arm.singular_measure(joints).least < 0.02:
                continue
            pose, branch = arm.forward(joints), arm.branch_of(joints)
            found = arm.solve_branch(pose, branch, joints)
            assert found == pytest.approx(joints, abs=1e-9)
            assert arm.forward(found).distance_mm(pose) < 1e-9
            for one in {solution.branch: solution for solution in arm.solutions(pose)}.values():
                assert arm.forward(one.joints_rad).distance_mm(pose) < 1e-9
                assert arm.branch_of(one.joints_rad) == one.branch


@each_model
def test_next_to_known_joint_angles_the_inverse_is_as_exact_and_depends_on_nothing_before(
    model: str,
) -> None:
    rng = random.Random(5)
    followed = 0
    for _ in range(10):
        arm = CalibratedUniversalRobot(DIMENSIONS[model], random_calibration(rng))
        for _ in range(10):
            joints = random_joints(rng)
            if arm.singular_measure(joints).least < 0.02:
                continue
            pose, branch = arm.forward(joints), arm.branch_of(joints)
            near = joint_vector(
                angle + rng.uniform(-1.0, 1.0) * 10 ** rng.uniform(-6, -2) for angle in joints
            )
            found = arm.local_inverse.solve(pose, branch, near)
            if found is None:
                continue
            followed += 1
            assert found == pytest.approx(joints, abs=1e-10)
            assert arm.forward(found).distance_mm(pose) < 1e-9
            arm.local_inverse.solve(pose, branch, joints)
            assert arm.local_inverse.solve(pose, branch, near) == found
    assert followed > 80


def test_another_branch_and_a_range_that_ends_in_between_are_left_to_the_closed_form() -> None:
    arm = CalibratedUniversalRobot(DIMENSIONS[UR5E], random_calibration(random.Random(6)))
    joints: JointVector = (0.3, -1.4, -1.3, -1.2, 1.1, 0.4)
    for solution in arm.solutions(arm.forward(joints)):
        is_here = solution.branch == arm.branch_of(joints)
        found = arm.local_inverse.solve(arm.forward(joints), solution.branch, joints)
        assert (found is not None) == is_here
    beyond = (2.0 * pi + 1e-3, *joints[1:])
    assert arm.local_inverse.solve(arm.forward(beyond), arm.branch_of(joints), beyond) is None


def axes_of(arm: CalibratedUniversalRobot, tilt_rad: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the axes at joint zero, those of elbow and wrist 1 tilted towards the shoulder's."""
    point, axes = np.array(arm.chain.base_mm), []
    for joint in arm.chain.joints:
        axes.append((point, np.array(joint.axis)))
        point = point + joint.to_next_mm
    for number, tilt in ((2, tilt_rad), (3, -0.4 * tilt_rad)):
        about = Rotation.from_rotvec(tilt * np.array([0.045, 0.0, 1.0]))
        axes[number] = (axes[number][0], about.apply(axes[number][1]))
    return axes


@each_model
def test_an_arm_whose_axes_meet_hundreds_of_metres_away_is_as_good_as_any(model: str) -> None:
    """The oracle turns the flange about the axes themselves: no Denavit-Hartenberg parameter in it."""
    nominal = CalibratedUniversalRobot(DIMENSIONS[model], FactoryCalibration())
    axes = axes_of(nominal, 1e-3)
    flange = nominal.flange_pose(ZEROS).as_matrix()
    *rows, last = rows_of_axes(axes, flange)
    assert abs(rows[1].d_mm) > 100e3
    columns = [joint_vector(column) for column in zip(*rows, last, strict=True)]
    theta, d, a, alpha = columns
    calibration = FactoryCalibration.from_parameters(DIMENSIONS[model], theta, a, d, alpha)
    arm = CalibratedUniversalRobot(DIMENSIONS[model], calibration)
    at_zero = arm.forward(ZEROS)
    assert all(np.abs(joint.to_next_mm).max() < 450.0 for joint in arm.chain.joints)
    rng = random.Random(3)
    for _ in range(20):
        joints = random_joints(rng)
        place, turn = np.array(at_zero.position_mm), Rotation.identity()
        for (point, direction), angle in zip(reversed(axes), reversed(joints), strict=True):
            about = Rotation.from_rotvec(angle * direction)
            place, turn = point + about.apply(place - point), about * turn
        assert arm.forward(joints).position_mm == pytest.approx(place, abs=1e-8)
        expected = turn.as_matrix() @ np.reshape(at_zero.rotation, (3, 3))
        assert np.reshape(arm.forward(joints).rotation, (3, 3)) == pytest.approx(expected, abs=1e-11)
        if arm.singular_measure(joints).least > 0.02:
            found = arm.solve_branch(arm.forward(joints), arm.branch_of(joints), joints)
            assert arm.forward(found).distance_mm(arm.forward(joints)) < 1e-9


def test_a_calibrated_arm_refuses_what_the_nominal_one_refuses() -> None:
    arm = CalibratedUniversalRobot(DIMENSIONS[UR5E], random_calibration(random.Random(4)))
    for branch in arm.branches:
        with pytest.raises(Unreachable):
            arm.solve_branch(Pose((3000.0, 0.0, 500.0)), branch, arm.home_rad)
    straight = universal_robot(UR5E).forward((0.2, -1.4, -1.7, 0.5, 0.0, 0.8))
    with pytest.raises(Singular):
        arm.solutions(straight)


@pytest.mark.parametrize(
    "wrong",
    [
        FactoryCalibration(d_mm=(float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0)),
        FactoryCalibration(a_mm=(0.0, 25.0, 0.0, 0.0, 0.0, 0.0)),
        FactoryCalibration(alpha_rad=(0.0, 0.0, 0.0, 0.2, 0.0, 0.0)),
    ],
    ids=["not a number", "longer upper arm", "twisted wrist"],
)
def test_a_calibration_that_no_factory_measures_is_refused(wrong: FactoryCalibration) -> None:
    with raises(CALIBRATION_OF_ANOTHER_ARM, match="ARM-010"):
        CalibratedUniversalRobot(DIMENSIONS[UR5], wrong)


def test_the_calibration_of_the_other_model_is_refused() -> None:
    other = DIMENSIONS[UR5E]
    parameters = FactoryCalibration.from_parameters(
        DIMENSIONS[UR5],
        ZEROS,
        joint_vector(link.position_mm[0] for link in other.links),
        joint_vector(link.position_mm[2] for link in other.links),
        ALPHA_RAD,
    )
    with raises(CALIBRATION_OF_ANOTHER_ARM) as refused:
        CalibratedUniversalRobot(DIMENSIONS[UR5], parameters)
    assert refused.value.code == "ARM-010"
