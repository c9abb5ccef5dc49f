"""Inverse kinematics: every branch leads back to the pose, and what cannot be reached says why."""

import math

import numpy as np
import pytest

from ronna_hw.arm.errors import BranchUnavailable, OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.inverse import Branch, branch_of, in_branch, nearest, solutions, solve_branch, turn_of
from ronna_hw.arm.kinematics import forward
from ronna_hw.arm.model import ArmVariant, arm_model, radians6
from ronna_hw.arm.pose import Pose

HOME = radians6(0, -90, 90, 0, 90, 0)


def _gap(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("variant", list(ArmVariant))
def test_ten_thousand_random_poses_come_back(variant: ArmVariant) -> None:
    model = arm_model(variant)
    random = np.random.default_rng(11)
    for joints in map(tuple, random.uniform(model.lower_rad, model.upper_rad, (10_000, 6)).tolist()):
        pose = forward(model, joints)
        found = solutions(model, pose)
        assert _gap(nearest(found, joints).joints_rad, joints) < 1e-6
        assert _gap(solve_branch(model, pose, branch_of(model, joints), joints), joints) < 1e-6
        worst = max(found, key=lambda s: forward(model, s.joints_rad).distance_mm(pose))
        assert forward(model, worst.joints_rad).distance_mm(pose) < 1e-6


@pytest.mark.parametrize("variant", list(ArmVariant))
def test_every_solution_is_in_range_in_its_branch_and_at_the_pose(variant: ArmVariant) -> None:
    model = arm_model(variant)
    random = np.random.default_rng(12)
    branches = set()
    for joints in map(tuple, random.uniform(model.lower_rad, model.upper_rad, (300, 6)).tolist()):
        pose = forward(model, joints)
        found = solutions(model, pose)
        assert len({s.joints_rad for s in found}) == len(found)
        for branch, angles in found:
            branches.add(branch)
            assert branch_of(model, angles) == branch
            assert forward(model, angles).angle_rad(pose) < 1e-9
            for low, angle, high in zip(model.lower_rad, angles, model.upper_rad, strict=True):
                assert low - 1e-8 <= angle <= high + 1e-8
    assert len(branches) == 8


def test_branches_of_one_pose_are_distinct_and_chosen_explicitly() -> None:
    model = arm_model(ArmVariant.SIXX)
    pose = forward(model, radians6(20, -140, 100, 30, 40, 50))
    found = solutions(model, pose)
    assert {s.branch.status for s in found} == {0, 3, 4, 7}  # the others leave the ranges here
    ours = branch_of(model, radians6(20, -140, 100, 30, 40, 50))
    assert {s.branch for s in in_branch(found, ours)} == {ours}
    reference = radians6(20, -140, 100, 30, 40, -310)
    assert nearest(found, reference).joints_rad == pytest.approx(reference, abs=1e-9)


def test_whole_turns_of_the_hand_are_offered_when_the_range_allows() -> None:
    model = arm_model(ArmVariant.SIXX)
    pose = forward(model, radians6(0, -90, 90, 178, 60, 100))
    same = in_branch(solutions(model, pose), Branch(False, True, False))
    turned = {(round(math.degrees(s.joints_rad[3])), round(math.degrees(s.joints_rad[5]))) for s in same}
    assert turned == {(178, 100), (178, -260), (-182, 100), (-182, -260)}


def test_weights_change_which_solution_is_nearest() -> None:
    model = arm_model(ArmVariant.SIXX)
    found = solutions(model, forward(model, radians6(20, -80, 100, 10, 60, 50)))
    only_A4 = nearest(found, radians6(20, -80, 100, -170, 60, 50), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    assert math.degrees(only_A4.joints_rad[3]) == pytest.approx(-170)
    assert only_A4.branch.flipped


def test_status_and_turn_follow_the_signs() -> None:
    assert Branch(True, True, True).status == 7
    assert turn_of(radians6(-1, 1, -1, 1, 1, -1)) == 0b100101
    assert branch_of(arm_model(ArmVariant.SIXX), HOME) == Branch(False, True, False)


def test_a_pose_out_of_reach_says_how_far() -> None:
    model = arm_model(ArmVariant.SIXX)
    with pytest.raises(Unreachable, match=r"limit 33\.5 to 876\.5 mm, got 1975") as caught:
        solutions(model, Pose.from_kuka(2080, 0, 400, 0, 90, 0))
    assert caught.value.code == "ARM-001"
    with pytest.raises(Unreachable):
        solve_branch(model, Pose.from_kuka(2080, 0, 400, 0, 90, 0), Branch(False, True, False), HOME)


@pytest.mark.hazard(22)
def test_a_stretched_hand_a_wrist_over_the_base_and_a_straight_elbow_are_singular() -> None:
    model = arm_model(ArmVariant.SIXX)
    hand = forward(model, radians6(0, -90, 90, 0, 0, 0))
    with pytest.raises(Singular, match="A4 and A6") as caught:
        solutions(model, hand)
    assert caught.value.code == "ARM-002"
    with pytest.raises(Singular, match="A4 and A6"):
        solve_branch(model, hand, Branch(False, True, False), HOME)
    with pytest.raises(Singular, match="axis of A1"):
        solutions(model, Pose.from_kuka(0, 0, 1000 - 80, 0, 180, 0))
    straight = (0.0, -1.0, model.stretched_A3_rad, 0.3, 0.5, 0.1)
    with pytest.raises(Singular, match="elbow"):
        solutions(model, forward(model, straight))


def test_a_pose_that_only_forbidden_angles_reach_names_the_axis() -> None:
    model = arm_model(ArmVariant.SIXX)
    behind = forward(model, radians6(178, -20, 60, 0, 60, 0))  # A1 beyond its 170 deg
    with pytest.raises(OutOfJointRange, match="A1 would leave its range") as caught:
        solve_branch(model, behind, Branch(False, True, False), HOME)
    assert caught.value.code == "ARM-003"
    folded = forward(model, radians6(175, -90, 20, 0, 60, 0))  # nor does any other branch fit
    with pytest.raises(OutOfJointRange, match="every branch"):
        solutions(model, folded)
    bent = forward(model, radians6(0, -90, 90, 0, 125, 0))
    with pytest.raises(OutOfJointRange, match="A5"):
        solve_branch(model, bent, Branch(False, True, False), HOME)


def test_choosing_from_nothing_is_refused() -> None:
    model = arm_model(ArmVariant.SIXX)
    with pytest.raises(BranchUnavailable) as caught:
        nearest((), HOME)
    assert caught.value.code == "ARM-004"
    with pytest.raises(BranchUnavailable, match="status 7"):
        in_branch(
            [s for s in solutions(model, forward(model, HOME)) if s.branch.status != 7],
            Branch(True, True, True),
        )
