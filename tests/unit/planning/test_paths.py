"""The whole procedure is checked kinematically first: every pose, line and branch."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded_errors import raises

from procedures.planning.errors import NotReachable
from procedures.planning.free_angle import WristState
from procedures.planning.paths import check_paths, rank_branches
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import ArmSetting, Axes, Visit, list_visits
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.pose import radians6
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform

FIDUCIALS = [[60.0, -70.0, 60.0], [-50.0, -75.0, 55.0], [5.0, -40.0, 100.0]]
TRAJECTORIES = (
    Trajectory("T1", (10.0, -80.0, 60.0), (5.0, -20.0, 20.0)),
    Trajectory("T2", (-20.0, -70.0, 70.0), (-15.0, -10.0, 25.0), math.radians(30.0)),
)


def visits(setting: ArmSetting) -> tuple[Visit, ...]:
    axes = Axes.of(setting, TRAJECTORIES, FIDUCIALS)
    return list_visits(setting, axes, FIDUCIALS, setting.kinematics.branch_of(setting.start_rad))


@pytest.fixture
def checked(make_arm):
    return check_paths(make_arm(), TRAJECTORIES, FIDUCIALS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("T1/fiducial 2", "sphere 3"),
        ("neutral orientation/fiducials", "the spheres"),
        ("T1/target", "the target"),
        ("home", "home"),
        ("gauge", "the gauge"),
    ],
)
def test_a_pose_keeps_its_text_in_records_and_is_worded_for_people(text: str, words: str) -> None:
    name = PoseName.parse(text)
    assert (str(name), name.in_sentence()) == (text, words)


@pytest.mark.parametrize("text", ["", "T1", "T1/fiducial 02", "T1/fiducial two", "T1/target ", "/target"])
def test_a_text_that_names_no_pose_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"pose|PoseKind|int"):
        PoseName.parse(text)


def test_every_localization_and_target_is_visited_in_order(make_arm):
    localized = [f"{name}/fiducial {number}" for name in ("T1", "T2") for number in range(3)]
    assert [str(one.name) for one in visits(make_arm())] == [*localized, "T1/target", "T2/target"]


def test_the_approach_begins_60_mm_before_the_tool_comes_to_rest(make_arm):
    visit = visits(make_arm())[-1]
    rest = make_arm().robot_from_ct.apply(TRAJECTORIES[1].rest_mm)
    before = visit.approach.inverse().apply(rest)
    assert visit.name.kind is PoseKind.TARGET
    assert before == pytest.approx([0.0, 0.0, 60.0])


def test_the_joints_reach_the_poses(checked, make_arm):
    assert checked.passed
    tool = make_arm().flange_from_tool
    for one in checked.reached:
        for joints, wanted in ((one.at_rad, one.visit.pose), (one.approach_rad, one.visit.approach)):
            reached = make_arm().kinematics.flange_pose(joints) @ tool
            assert np.allclose(reached.as_matrix(), wanted.as_matrix(), atol=1e-6)


def test_an_arm_with_an_offset_wrist_reaches_the_whole_procedure(make_arm):
    arm = universal_robot("ur5")
    setting = make_arm(kinematics=arm, start_rad=arm.home_rad)
    result = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    result.require()
    for one in result.reached:
        assert arm.branch_of(one.at_rad) == result.branch
        reached = arm.flange_pose(one.at_rad) @ setting.flange_from_tool
        assert np.allclose(reached.as_matrix(), one.visit.pose.as_matrix(), atol=1e-6)
    assert WristState.of(arm, result).least_bend_rad > 0.0


def test_one_branch_is_kept_over_the_whole_procedure(checked, make_arm):
    kinematics = make_arm().kinematics
    for one in checked.reached:
        assert kinematics.branch_of(one.approach_rad) == kinematics.branch_of(one.at_rad) == checked.branch
    assert len(checked.reached) == 8


def test_joints_stay_within_their_limits_and_their_ranges_are_reported(checked, make_arm):
    arm = make_arm().kinematics
    for (low, high), lower, upper in zip(checked.joint_ranges_rad, arm.lower_rad, arm.upper_rad, strict=True):
        assert lower <= low <= high <= upper


def test_the_largest_turn_is_between_two_approach_points_or_from_the_start(checked, make_arm):
    places = [make_arm().start_rad, *(one.approach_rad for one in checked.reached)]
    assert checked.largest_turn_rad == pytest.approx(np.abs(np.diff(places, axis=0)).max())


def test_another_starting_branch_is_kept_when_it_works(make_arm, checked):
    flipped = radians6(0.0, -90.0, 90.0, 180.0, -90.0, 180.0)
    result = check_paths(make_arm(start_rad=flipped), TRAJECTORIES, FIDUCIALS)
    assert result.passed
    assert result.branch == make_arm().kinematics.branch_of(flipped)
    assert result.branch != checked.branch


def test_the_branch_that_reaches_most_poses_is_tried_first(make_arm, checked):
    setting = make_arm()
    flanges = [one.visit.pose @ setting.flange_from_tool.inverse() for one in checked.reached]
    assert rank_branches(setting.kinematics, flanges, setting.start_rad)[0] == checked.branch
    overhead = radians6(180.0 - 15.0, -90.0, 90.0, 0.0, 90.0, 0.0)
    assert len(set(rank_branches(setting.kinematics, flanges, overhead))) == 8


@pytest.mark.hazard(23)
def test_unmet_preconditions_name_pose_and_reason(make_arm):
    far = [*FIDUCIALS[:2], [5.0, -40.0, -600.0]]
    result = check_paths(make_arm(), TRAJECTORIES, far)
    assert not result.passed
    assert [str(one.pose) for one in result.unmet] == ["T1/fiducial 2", "T2/fiducial 2"]
    assert all("ARM-00" in one.reason for one in result.unmet)
    assert len(result.reached) == 6
    with pytest.raises(NotReachable, match=r"PLAN-007.*T1/fiducial 2"):
        result.require()


def test_a_head_out_of_reach_leaves_every_pose_unmet(make_arm):
    result = check_paths(make_arm((1500.0, 0.0, 250.0)), TRAJECTORIES, FIDUCIALS)
    assert len(result.unmet) == 8
    assert result.joint_ranges_rad == ()


def test_reach_is_checked_before_fiducials_are_known(make_arm):
    assert check_paths(make_arm(), TRAJECTORIES, ()).passed
    unmet = check_paths(make_arm((1500.0, 0.0, 250.0)), TRAJECTORIES, ()).unmet
    assert [str(one.pose) for one in unmet] == ["T1/target", "T2/target"]


def test_the_stereo_head_and_the_guide_may_differ(make_arm):
    tip = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(220.03, -0.02, 60.05))
    setting = make_arm(flange_from_tool=tip, flange_from_stereo=make_arm().flange_from_tool)
    result = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    stereo, guide = (result.at(PoseName.parse(name)) for name in ("T1/fiducial 0", "T1/target"))
    by_stereo = setting.kinematics.flange_pose(stereo.at_rad) @ make_arm().flange_from_tool
    by_guide = setting.kinematics.flange_pose(guide.at_rad) @ tip
    assert np.allclose(by_stereo.translation_mm, stereo.visit.pose.translation_mm, atol=1e-6)
    assert np.allclose(by_guide.translation_mm, guide.visit.pose.translation_mm, atol=1e-6)


def test_wrong_frames_are_refused(make_arm):
    with raises(FRAME_MISMATCH, match="FRM-001"):
        make_arm(robot_from_ct=make_arm().flange_from_tool)
    with raises(FRAME_MISMATCH, match="FRM-001"):
        make_arm(flange_from_stereo=make_arm().robot_from_ct)
