"""Inverse kinematics: every branch leads back to the pose, and unreachable poses are explained."""

import math

import pytest

from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.kr6_r900.inverse import branch
from ronna_hw.arm.pose import Pose, radians6

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
