"""What the tracker should see past the arm, against the simulator's own bodies of the arm."""

from __future__ import annotations

import numpy as np
from room_trials import TrackedCase
from sight_trials import GuideSight

from procedures.planning.tracker_sight import TrackerSight
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.frames import Frame, Transform

SCENES = 8
LEAST_AGREEMENT = 0.97  # sphere by sphere; the bodies of planning are thicker than those of the simulator


def test_a_sphere_behind_the_forearm_is_hidden_and_one_off_to_the_side_is_not() -> None:
    arm = kr6_r900()
    wrist_mm = arm.flange_pose(arm.home_rad).translation_mm
    # The tracker looks along -x of the robot, from the far side: z of the tracker points to it.
    tracker_mm = wrist_mm + np.array((1500.0, 0.0, 0.0))
    robot_from_tracker = Transform.of(
        Frame.ROBOT, Frame.TRACKER, translation_mm=tracker_mm, quaternion_wxyz=(0.5**0.5, 0.0, 0.5**0.5, 0.0)
    )
    behind, beside = wrist_mm - np.array((300.0, 0.0, 0.0)), wrist_mm + np.array((0.0, 600.0, 0.0))
    spheres_mm = robot_from_tracker.inverse().apply([behind, beside])
    seen = TrackerSight(robot_from_tracker, spheres_mm).seen(arm, Surroundings(), arm.home_rad)
    assert seen.tolist() == [False, True]


def test_expected_visibility_agrees_with_the_simulator_for_nearly_every_sphere() -> None:
    said = []
    for seed in range(SCENES):
        case = TrackedCase(seed)
        sight = GuideSight(case)
        for joints in (joints for approach in sight.approaches for joints in approach):
            said.extend(sight.expected(joints) == sight.seen(joints))
    assert np.mean(said) >= LEAST_AGREEMENT
