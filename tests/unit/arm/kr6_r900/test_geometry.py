"""Flange poses against golden ones, poses as values, and the inverse: every branch, and none out of reach."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded_errors import raises
from kr6_golden_poses import GOLDEN

from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kr6_r900 import R900_2, SIXX, Kr6R900, kr6_r900
from ronna_hw.arm.kr6_r900.inverse import branch
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


HOME = radians6(0, -90, 90, 0, 90, 0)
USUAL = branch(overhead=False, elbow=True, flipped=False)


def test_branches_of_one_pose_are_distinct_and_chosen_explicitly() -> None:
    model = kr6_r900(SIXX)
    pose = model.forward(radians6(20, -140, 100, 30, 40, 50))
    found = model.solutions(pose)
    assert {s.branch for s in found} == {0, 3, 4, 7}  # the others leave the ranges here
    ours = model.branch_of(radians6(20, -140, 100, 30, 40, 50))
    assert ours in {s.branch for s in found}
    reference = radians6(20, -140, 100, 30, 40, -310)
    assert any(s.joints_rad == pytest.approx(reference, abs=1e-9) for s in found)


def test_whole_turns_of_the_wrist_are_offered_when_the_range_allows() -> None:
    model = kr6_r900(SIXX)
    pose = model.forward(radians6(0, -90, 90, 178, 60, 100))
    same = [s for s in model.solutions(pose) if s.branch == USUAL]
    turned = {(round(math.degrees(s.joints_rad[3])), round(math.degrees(s.joints_rad[5]))) for s in same}
    assert turned == {(178, 100), (178, -260), (-182, 100), (-182, -260)}


def test_the_branch_matches_the_status_of_kuka() -> None:
    assert branch(overhead=True, elbow=True, flipped=True) == 7
    assert kr6_r900(SIXX).branch_of(HOME) == USUAL == 2


def test_a_pose_out_of_reach_reports_its_distance() -> None:
    model = kr6_r900(SIXX)
    with pytest.raises(Unreachable, match=r"limit 33\.5 to 876\.5 mm, got 1975") as caught:
        model.solutions(Pose.from_kuka(2080, 0, 400, 0, 90, 0))
    assert caught.value.code == "ARM-001"
    with pytest.raises(Unreachable):
        model.solve_branch(Pose.from_kuka(2080, 0, 400, 0, 90, 0), USUAL, HOME)


@pytest.mark.hazard(22)
def test_an_aligned_wrist_a_wrist_over_the_base_and_a_straight_elbow_are_singular() -> None:
    model = kr6_r900(SIXX)
    hand = model.forward(radians6(0, -90, 90, 0, 0, 0))
    with pytest.raises(Singular, match="A4 and A6") as caught:
        model.solutions(hand)
    assert caught.value.code == "ARM-002"
    with pytest.raises(Singular, match="A4 and A6"):
        model.solve_branch(hand, USUAL, HOME)
    with pytest.raises(Singular, match="axis of A1"):
        model.solutions(Pose.from_kuka(0, 0, 1000 - 80, 0, 180, 0))
    straight = (0.0, -1.0, model.dimensions.stretched_A3_rad, 0.3, 0.5, 0.1)
    with pytest.raises(Singular, match="elbow"):
        model.solutions(model.forward(straight))


def test_a_pose_reachable_only_at_forbidden_angles_names_the_axis() -> None:
    model = kr6_r900(SIXX)
    behind = model.forward(radians6(178, -20, 60, 0, 60, 0))  # A1 beyond its 170 deg
    with pytest.raises(OutOfJointRange, match="A1 would leave its range") as caught:
        model.solve_branch(behind, USUAL, HOME)
    assert caught.value.code == "ARM-003"
    folded = model.forward(radians6(175, -90, 20, 0, 60, 0))  # nor does any other branch fit
    with pytest.raises(OutOfJointRange, match="every branch"):
        model.solutions(folded)
    bent = model.forward(radians6(0, -90, 90, 0, 125, 0))
    with pytest.raises(OutOfJointRange, match="A5"):
        model.solve_branch(bent, USUAL, HOME)
