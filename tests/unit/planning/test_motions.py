"""Every motion of the procedure clears head, clamp and table, or is refused with pair and place."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from half_sitting import FIDUCIALS, TRAJECTORIES, arm_setting, scene_with
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import HOME_RAD, KR6

from procedures.planning.errors import NotReachable
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.motions import plan_motions, preview_motions
from procedures.planning.paths import check_paths
from procedures.planning.pose_name import HOME, PoseKind, PoseName
from procedures.planning.scene import PlanningScene
from procedures.strategies.trajectory import Trajectory
from ronna_hw.collision_config import BodyFrame, CollisionConfig, RoomBody
from ronna_hw.frames import Frame, Transform


def ball(name: str, place_mm: tuple[float, float, float], radius_mm: float) -> RoomBody:
    """Ball in the room, robot frame."""
    return RoomBody(name=name, start_mm=place_mm, end_mm=place_mm, radius_mm=radius_mm, frame=BodyFrame.ROBOT)


def test_the_motions_lead_from_home_through_all_visits_and_back_home() -> None:
    setting = arm_setting()
    assert setting.scene is not None
    check = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    assert check.passed, check.unmet
    motions = list(plan_motions(setting, setting.scene, check, TRAJECTORIES))
    every = [one.plan for one in motions if one.kind in ("line", "reserve")]
    assert every == [one.line for one in check.reached]  # the head may have to back off from any sphere
    motions = [one for one in motions if one.kind != "reserve"]
    assert motions[0].start == motions[-1].end == HOME
    for before, after in pairwise(motions):
        # A line ends where it will be left: at its approach point.
        assert after.start == before.end
    exchanged = [motion for motion in motions[:-1] if motion.end == HOME]
    assert len(exchanged) >= 1
    assert {part.name for part in motions[0].around.tool} != {part.name for part in motions[-1].around.tool}
    lines = [motion.plan for motion in motions if motion.kind == "line"]
    back = [motion.plan for motion in motions if motion.kind == "back"]
    # The head goes straight over each sphere, and backs off along a line from the last one of a trajectory.
    at_targets = [one.line for one in check.reached if one.visit.name.kind is PoseKind.TARGET]
    assert lines == at_targets
    assert len(back) == 2 * len(at_targets) < len(check.reached)
    for again in back:
        (there,) = (one.line for one in check.reached if one.line.target_rad == again.start_rad)
        end_rad = again.path(setting.kinematics).joints(1.0, again.start_rad)
        assert end_rad == pytest.approx(there.start_rad, abs=1e-6)


def test_every_motion_has_a_preview_that_can_be_recorded() -> None:
    setting = arm_setting()
    assert setting.scene is not None
    check = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    previews = preview_motions(setting, setting.scene, check, TRAJECTORIES)
    payload = json.loads(json.dumps([one.as_payload() for one in previews], allow_nan=False))
    assert all(motion["clear"] for motion in payload)
    assert all(motion["closest"]["distance_mm"] >= 10.0 - 0.5 for motion in payload)
    into = [motion for motion in payload if motion["kind"] == "line" and motion["to"].endswith("target")]
    assert len(into) == 2
    assert all(motion["nearest_to_head_mm"] >= 10.0 - 0.5 for motion in into)  # held outside the skin


@pytest.mark.hazard(24)
@pytest.mark.hazard(5)
def test_a_clamp_in_the_way_is_named_with_the_pose_and_the_distance() -> None:
    free = check_paths(arm_setting(), TRAJECTORIES, FIDUCIALS)
    x, y, z = free.at(PoseName.parse("T2/target")).visit.approach.apply([0.0, 0.0, -120.0]).tolist()
    setting = arm_setting(scene=scene_with(ball("arm of the clamp", (x, y, z), 20.0)))
    check = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    assert not check.passed
    assert "T2/target" in {str(one.pose) for one in check.unmet}
    with pytest.raises(
        NotReachable, match=r"PLAN-007: .*T2/target: .* mm into the arm of the clamp, .*ARM-007"
    ):
        check.require()


@pytest.mark.hazard(24)
def test_a_guide_held_too_close_to_the_head_is_refused_with_the_stand_off_and_a_least_distance() -> None:
    first = TRAJECTORIES[0]
    close = first.with_rest(first.beyond_mm + 27.0, standoff_mm=3.0)
    setting = arm_setting()
    check = check_paths(setting, (close,), FIDUCIALS)
    with pytest.raises(NotReachable) as caught:
        check.require()
    said = str(caught.value)
    assert "T1/target: on the line to it the end of the guide runs" in said
    assert "mm into the head, where the guide is held, with the plan's standoff_mm of 3" in said
    assert "expected at least 10 mm between them" in said
    assert "limit" not in said
    words = check.unmet[0].words
    assert "mm into the head, where the guide is held, at a stand-off of 3 mm: expected at least" in words
    assert "ARM-" not in words


@pytest.mark.hazard(24)
def test_another_angle_about_the_axis_is_chosen_when_the_planned_one_is_not_clear() -> None:
    free = arm_setting()
    own = check_paths(free, TRAJECTORIES[:1], FIDUCIALS)
    # A drip stand where the mount would be, beside the tool.
    place = own.at(PoseName.parse("T1/target")).visit.pose.apply([-130.0, 0.0, -120.0]).tolist()
    setting = arm_setting(scene=scene_with(ball("drip stand", (place[0], place[1], place[2]), 15.0)))
    assert not check_paths(setting, TRAJECTORIES[:1], FIDUCIALS).passed
    far_aside = StereoSight(np.array([0.0, -115.0, -222.0]), np.array([0.0, 115.0, -222.0]))
    turned = choose_free_angles(setting, TRAJECTORIES[:1], FIDUCIALS, far_aside)
    assert turned.check.passed, turned.check.unmet
    assert turned.turns_rad[TRAJECTORIES[0].identifier] != 0.0


@pytest.mark.hazard(24)
def test_an_angle_between_two_steps_of_the_search_is_found() -> None:
    """Up to -41 deg the plate of the mount is too close to the head; from -44 deg on a sphere is hidden."""
    turned_as = Rotation.from_quat([-0.16206, -0.16149, 0.69769, 0.67889])
    at = RigidTransform.from_components([1090.49, -11.93, -549.57], turned_as)
    spheres = ((-34.17, -116.35, 877.74), (-50.1, -128.91, 833.95), (24.04, -149.5, 805.02))
    head = HeadEllipsoid(centre_mm=(3.14, -42.46, 812.43), semi_axes_mm=(79.3, 100.5, 94.32))
    setting = arm_setting(
        Transform(Frame.ROBOT, Frame.CT, at),
        scene=PlanningScene(CollisionConfig(margin_mm=12.0), head, spheres),
    )
    trajectory = Trajectory("T1", (24.41, -89.05, 886.16), (8.69, -72.1, 846.59)).with_rest(9.18)
    sight = StereoSight(np.array([-0.2, -115.42, -222.15]), np.array([-0.22, 115.46, -221.91]))
    turned = choose_free_angles(setting, (trajectory,), spheres, sight)
    assert turned.check.passed, turned.check.unmet
    assert -44.0 < math.degrees(turned.turns_rad["T1"]) < -41.0


def test_a_body_at_home_is_reported_under_a_planned_pose() -> None:
    """The search for angles drops the poses that are named; home is none of them."""
    above = KR6.forward(HOME_RAD).apply((220.0, 60.0, 60.0))
    setting = arm_setting(scene=scene_with(ball("lamp", above, 40.0)))
    check = check_paths(setting, TRAJECTORIES[:1], FIDUCIALS[:1])
    assert not check.passed
    assert {str(one.pose) for one in check.unmet} <= {"T1/fiducial 0", "T1/target"}
    assert any("lamp" in one.reason for one in check.unmet)
