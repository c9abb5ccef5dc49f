"""Turning about a trajectory's axis until the stereo head sees every sphere and the arm reaches it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest
from half_sitting import CAMERA_MM, SIGHT, arm_setting

from procedures.planning.free_angle import LEAST_BEND_RAD, WristState, choose_free_angles
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.paths import check_paths
from procedures.planning.pose_name import PoseKind
from procedures.planning.scene import PlanningScene
from procedures.planning.tracker_sight import TrackerSight
from procedures.planning.visits import Axes, Visit, list_visits
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.strategies.strategy import OUTWARDS_RAD, intermediate_turns_rad
from procedures.strategies.trajectory import Trajectory
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

# CT axes as the robot's, seen from above: the trajectory points straight down.
SETTING = arm_setting(Transform.of(Frame.ROBOT, Frame.CT, translation_mm=(650.0, 0.0, 300.0)), scene=None)
DOWN = Trajectory("T1", (0.0, 0.0, 40.0), (0.0, 0.0, 0.0))
FREE = np.array([[60.0, 0.0, 50.0], [-50.0, 40.0, 60.0], [-40.0, -60.0, 40.0]])


def visits(trajectory: Trajectory, fiducials: np.ndarray) -> tuple[Visit, ...]:
    axes = Axes.of(SETTING, (trajectory,), fiducials)
    return list_visits(SETTING, axes, fiducials, SETTING.kinematics.branch_of(SETTING.start_rad))


def _beside_the_line_of_sight() -> np.ndarray:
    """A second sphere 60 mm from the first, right between it and the right camera."""
    pose = visits(DOWN, FREE)[0].pose
    towards = pose.apply(CAMERA_MM) - pose.translation_mm
    blocker = pose.translation_mm + 60.0 * towards / np.linalg.norm(towards)
    return np.vstack([FREE, SETTING.robot_from_ct.inverse().apply(blocker)])


def test_a_sphere_in_the_line_of_sight_is_named_with_the_camera_and_one_behind_the_rim_counts_as_much() -> (
    None
):
    spheres = _beside_the_line_of_sight()
    found = SIGHT.unmet(visits(DOWN, spheres), SETTING.robot_from_ct.apply(spheres))
    reasons = {str(one.pose): one.reason for one in found}
    assert reasons["T1/fiducial 0"] == "sphere 4 is in front of or behind it in the right camera"
    assert "T1/fiducial 3" in reasons


def test_the_planned_angle_is_kept_when_every_sphere_is_seen() -> None:
    assert SIGHT.unmet(visits(DOWN, FREE), SETTING.robot_from_ct.apply(FREE)) == ()
    assert choose_free_angles(SETTING, (DOWN,), FREE, SIGHT).turns_rad == {"T1": 0.0}


def test_the_head_is_turned_about_the_planned_axis_until_the_hidden_sphere_is_seen() -> None:
    spheres = _beside_the_line_of_sight()
    turned = choose_free_angles(SETTING, (DOWN,), spheres, SIGHT)
    assert turned.check.passed
    assert turned.turns_rad["T1"] != 0.0
    along = turned.axes.targeted[0]
    assert (along.entry_mm, along.target_mm) == (DOWN.entry_mm, DOWN.target_mm)
    assert SIGHT.unmet(visits(along, spheres), SETTING.robot_from_ct.apply(spheres)) == ()


def test_a_sphere_hidden_at_every_angle_is_reported_as_unmet() -> None:
    ring = [
        FREE[0] + 14.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
        for angle in np.linspace(0.0, 2 * math.pi, 12, endpoint=False)
    ]
    check = choose_free_angles(SETTING, (DOWN,), np.vstack([FREE, ring]), SIGHT).check
    assert not check.passed
    assert any("camera" in one.reason for one in check.unmet)


def test_turns_are_tried_from_near_to_far_on_both_sides_and_each_once_between_the_steps() -> None:
    assert OUTWARDS_RAD[0] == 0.0
    assert np.all(np.diff(np.abs(OUTWARDS_RAD)) >= -1e-12)
    assert max(OUTWARDS_RAD) == pytest.approx(math.radians(90.0))
    assert min(OUTWARDS_RAD) == pytest.approx(math.radians(-90.0))
    between_deg = np.degrees(intermediate_turns_rad((math.radians(80.0), math.radians(90.0))))
    assert sorted(between_deg) == pytest.approx([75.0, 77.5, 82.5, 85.0, 87.5])


def _leaning(x_mm: float) -> Trajectory:
    return Trajectory("T1", (x_mm, 0.0, 40.0), (0.0, 0.0, 0.0))


def _wrist_at(trajectory: Trajectory, turn_rad: float) -> WristState | None:
    turned = replace(trajectory, free_angle_rad=trajectory.free_angle_rad + turn_rad)
    check = check_paths(SETTING, (turned,), FREE)
    return WristState.of(SETTING.kinematics, check) if check.passed else None


def test_an_angle_that_turns_the_wrist_far_is_replaced_by_the_next_good_one() -> None:
    leaning = _leaning(-40.0)
    own = _wrist_at(leaning, 0.0)
    assert own is not None
    assert not own.is_good
    turned = choose_free_angles(SETTING, (leaning,), FREE, SIGHT)
    assert WristState.of(SETTING.kinematics, turned.check).is_good
    assert turned.turns_rad == pytest.approx({"T1": math.radians(10.0)})


def test_the_wrist_is_turned_away_from_its_singularity() -> None:
    leaning = _leaning(-20.0)  # along the forearm
    own = _wrist_at(leaning, 0.0)
    assert own is not None
    assert own.least_bend_rad < math.radians(5.0)
    turned = choose_free_angles(SETTING, (leaning,), FREE, SIGHT)
    assert WristState.of(SETTING.kinematics, turned.check).least_bend_rad >= LEAST_BEND_RAD


def test_the_angle_farthest_from_the_singularity_is_chosen_when_none_is_good() -> None:
    leaning = _leaning(-22.0)
    wrists = [wrist for turn in OUTWARDS_RAD if (wrist := _wrist_at(leaning, turn)) is not None]
    assert not any(wrist.is_good for wrist in wrists)
    turned = choose_free_angles(SETTING, (leaning,), FREE, SIGHT)
    assert turned.check.passed
    best_rad = max(wrist.least_bend_rad for wrist in wrists)
    assert best_rad > 1.5 * wrists[0].least_bend_rad
    assert WristState.of(SETTING.kinematics, turned.check).least_bend_rad == pytest.approx(best_rad)


def test_the_wrist_is_judged_separately_for_each_trajectory() -> None:
    both = [replace(_leaning(x_mm), identifier=name) for name, x_mm in (("A", 20.0), ("B", -40.0))]
    turned = choose_free_angles(SETTING, both, FREE, SIGHT)
    assert turned.check.passed
    assert turned.turns_rad["A"] == 0.0


def test_a_wrist_is_good_only_away_from_the_singularity_and_similar_at_all_poses() -> None:
    assert WristState(LEAST_BEND_RAD, math.radians(44.0)).is_good
    assert not WristState(LEAST_BEND_RAD - 0.01, 0.0).is_good
    assert not WristState(math.radians(60.0), math.radians(46.0)).is_good


@pytest.mark.parametrize(("planned_deg", "kept"), [(0.0, True), (40.0, True), (-70.0, True), (150.0, False)])
def test_targets_that_share_their_localizations_keep_its_free_angle_whatever_is_planned(
    planned_deg: float, kept: bool
) -> None:
    neutral = replace(SETTING, strategy=NeutralOrientation())
    planned = replace(_leaning(20.0), free_angle_rad=math.radians(planned_deg))
    turned = choose_free_angles(neutral, (planned,), FREE, SIGHT)
    assert turned.check.passed
    shared, target = turned.axes.localized[0], turned.axes.targeted[0]
    difference_rad = math.remainder(target.free_angle_rad - shared.free_angle_rad, 2.0 * math.pi)
    assert (abs(difference_rad) < 1e-9) is kept  # a turn is at most a quarter: then as near as it goes
    assert abs(difference_rad) < math.radians(61.0)


@dataclass
class TrackerBeside:
    """A tracker that sees the head from one side: with the first axis turned that way."""

    asked: list[float] = field(default_factory=list)

    def seen(self, arm: object, surroundings: object, joints_rad: JointVector) -> np.ndarray:
        self.asked.append(joints_rad[0])
        return np.full(3, joints_rad[0] > 0.1)


@pytest.mark.hazard(60)
def test_a_turn_that_leaves_the_head_in_the_trackers_view_is_preferred() -> None:
    scene = PlanningScene(
        CollisionConfig(), HeadEllipsoid(centre_mm=(0.0, 0.0, -100.0), semi_axes_mm=(70.0, 90.0, 60.0))
    )
    watched = replace(SETTING, scene=scene, sights=(cast("TrackerSight", tracker := TrackerBeside()),))
    unwatched = choose_free_angles(replace(SETTING, scene=scene), (DOWN,), FREE, SIGHT)
    turned = choose_free_angles(watched, (DOWN,), FREE, SIGHT)
    (target,) = (one for one in turned.check.reached if one.visit.name.kind is PoseKind.TARGET)
    (before,) = (one for one in unwatched.check.reached if one.visit.name.kind is PoseKind.TARGET)
    assert before.at_rad[0] <= 0.1 < target.at_rad[0]
    assert len(tracker.asked) > 1
