"""Forward kinematics against golden flange poses, and poses as values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded_errors import raises
from kr6_golden_poses import GOLDEN

from ronna_hw.arm.kr6_r900 import R900_2, SIXX, Kr6R900, kr6_r900
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform


@pytest.mark.parametrize("variant", [SIXX, R900_2])
@pytest.mark.parametrize("row", GOLDEN, ids=lambda row: str(row[0]))
def test_the_flange_reaches_the_golden_pose(variant: str, row: tuple[tuple[float, ...], ...]) -> None:
    axes, sixx, second, abc = row
    xyz = sixx if variant is SIXX else second
    flange = kr6_r900(variant).forward(radians6(*axes))
    golden = Pose.from_kuka(*xyz, *abc)
    assert flange.distance_mm(golden) < 0.001
    assert math.degrees(flange.angle_rad(golden)) < 0.001


def test_the_reach_of_both_variants_is_the_published_one() -> None:
    reach = {v: kr6_r900(v).dimensions.reach_mm for v in (SIXX, R900_2)}
    assert reach[SIXX] == pytest.approx(901.5, abs=0.05)
    assert reach[R900_2] == pytest.approx(900.7, abs=0.05)


def test_an_unknown_variant_is_refused() -> None:
    with pytest.raises(KeyError, match="kr16"):
        kr6_r900("kr16")


def _random_poses(model: Kr6R900, count: int) -> list[Pose]:
    random = np.random.default_rng(5)
    return [
        model.forward(tuple(random.uniform(model.lower_rad, model.upper_rad).tolist())) for _ in range(count)
    ]


def test_a_pose_round_trips_through_every_notation() -> None:
    for pose in _random_poses(kr6_r900(SIXX), 200):
        for back in (
            Pose.from_kuka(*pose.to_kuka()),
            Pose.from_quaternion(pose.position_mm, pose.quaternion()),
            Pose.from_transform(pose.to_transform()),
            pose.compose(pose.inverse()).compose(pose),
        ):
            assert back.distance_mm(pose) < 1e-9
            assert back.angle_rad(pose) < 1e-9


def test_a_pose_agrees_with_the_equivalent_transform() -> None:
    a, b = _random_poses(kr6_r900(SIXX), 2)
    matrix = a.to_transform().as_matrix() @ b.to_transform().as_matrix()
    assert Pose.from_matrix(matrix.tolist()).distance_mm(a.compose(b)) < 1e-9
    assert a.apply((1.0, 2.0, 3.0)) == pytest.approx(a.to_transform().apply([1.0, 2.0, 3.0]))


def test_a_half_turn_about_each_axis_has_a_quaternion() -> None:
    for A, B, C in ((180, 0, 0), (0, 180, 0), (0, 0, 180), (180, 90, 0), (0, -90, 0)):
        pose = Pose.from_kuka(0, 0, 0, A, B, C)
        assert Pose.from_quaternion((0, 0, 0), pose.quaternion()).angle_rad(pose) < 1e-12


def test_only_a_flange_in_robot_transform_becomes_a_pose() -> None:
    with raises(FRAME_MISMATCH):
        Pose.from_transform(Transform.of(Frame.ROBOT, Frame.TOOL))
