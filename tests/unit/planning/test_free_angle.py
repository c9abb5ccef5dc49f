"""Turning about a trajectory's axis until the stereo head sees every sphere and the arm reaches it."""

import math

import numpy as np
import pytest

from procedures.planning.free_angle import FURTHEST_RAD, choose_free_angles, turns_rad
from procedures.planning.reach import ArmSetting, visits_of
from procedures.planning.sight import StereoSight
from procedures.strategies.ocs import OrientationCorrection
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.model import arm_model, radians6
from ronna_hw.frames import Frame, Transform

HALF_ANGLE_RAD = math.radians(27.5)
CAMERA_MM = 250.0 * np.array([0.0, math.sin(HALF_ANGLE_RAD), -math.cos(HALF_ANGLE_RAD)])
SIGHT = StereoSight(left_mm=CAMERA_MM * (1.0, -1.0, 1.0), right_mm=CAMERA_MM)
# CT axes as the robot's, seen from above: the trajectory points straight down.
SETTING = ArmSetting(
    arm_model("kr6_r900_sixx"),
    Transform.of(Frame.ROBOT, Frame.CT, translation_mm=(650.0, 0.0, 300.0)),
    Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(220.0, 0.0, 60.0)),
    OrientationCorrection(),
    start_rad=radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0),
)
DOWN = Trajectory("T1", (0.0, 0.0, 40.0), (0.0, 0.0, 0.0))
FREE = np.array([[60.0, 0.0, 50.0], [-50.0, 40.0, 60.0], [-40.0, -60.0, 40.0]])


def _beside_the_line_of_sight() -> np.ndarray:
    """A second sphere 60 mm from the first, right between it and the right camera."""
    pose = visits_of(SETTING, (DOWN,), FREE)[0].pose
    towards = pose.apply(CAMERA_MM) - pose.translation_mm
    blocker = pose.translation_mm + 60.0 * towards / np.linalg.norm(towards)
    return np.vstack([FREE, SETTING.robot_from_ct.inverse().apply(blocker)])


def test_spheres_that_stand_apart_are_all_seen() -> None:
    visits = visits_of(SETTING, (DOWN,), FREE)
    assert SIGHT.unmet(visits, SETTING.robot_from_ct.apply(FREE)) == ()


def test_a_sphere_in_the_line_of_sight_is_named_with_the_camera() -> None:
    spheres = _beside_the_line_of_sight()
    visits = visits_of(SETTING, (DOWN,), spheres)
    found = SIGHT.unmet(visits, SETTING.robot_from_ct.apply(spheres))
    reasons = {(one.pose, one.reason) for one in found}
    assert ("T1/fiducial 0", "sphere 4 stands before or behind it in the right camera") in reasons


def test_a_neighbour_behind_the_rim_counts_as_much_as_one_in_front() -> None:
    spheres = _beside_the_line_of_sight()
    visits = visits_of(SETTING, (DOWN,), spheres)
    hidden = {one.pose for one in SIGHT.unmet(visits, SETTING.robot_from_ct.apply(spheres))}
    assert "T1/fiducial 3" in hidden


def test_where_all_is_seen_the_plans_own_angle_is_kept() -> None:
    assert choose_free_angles(SETTING, (DOWN,), FREE, SIGHT).turns_rad == (0.0,)


def test_the_head_is_turned_until_the_hidden_sphere_is_seen() -> None:
    spheres = _beside_the_line_of_sight()
    turned = choose_free_angles(SETTING, (DOWN,), spheres, SIGHT)
    assert turned.check.passed
    assert turned.turns_rad[0] != 0.0
    visits = visits_of(SETTING, turned.trajectories, spheres)
    assert SIGHT.unmet(visits, SETTING.robot_from_ct.apply(spheres)) == ()


def test_turning_leaves_entry_target_and_axis_as_planned() -> None:
    turned = choose_free_angles(SETTING, (DOWN,), _beside_the_line_of_sight(), SIGHT).trajectories[0]
    assert (turned.entry_mm, turned.target_mm) == (DOWN.entry_mm, DOWN.target_mm)


def test_what_no_turn_can_show_is_reported_and_not_driven() -> None:
    ring = [
        FREE[0] + 14.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
        for angle in np.linspace(0.0, 2 * math.pi, 12, endpoint=False)
    ]
    check = choose_free_angles(SETTING, (DOWN,), np.vstack([FREE, ring]), SIGHT).check
    assert not check.passed
    assert any("camera" in one.reason for one in check.unmet)


def test_turns_go_from_near_to_far_on_both_sides() -> None:
    turns = list(turns_rad())
    assert turns[0] == 0.0
    assert np.all(np.diff(np.abs(turns)) >= -1e-12)
    assert max(turns) == pytest.approx(FURTHEST_RAD)
    assert min(turns) == pytest.approx(-FURTHEST_RAD)
