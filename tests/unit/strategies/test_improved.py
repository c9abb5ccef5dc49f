"""Improved JDMS matches the error at each fiducial to that at the target; best selects per trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from strategy_arms import ARM, FIDUCIALS, KR6, LEANING, ROOM

from procedures.calibration.arm_sources import ArmPoses, arm_sources
from procedures.registration.target_prediction import predict_target_error
from procedures.strategies.catalogue import BestOfEach, strategy_named
from procedures.strategies.trajectory import Trajectory, target_pose
from ronna_hw.arm.error_budget import ErrorSizes, displacements

CALIBRATED = ErrorSizes(tool_mm=0.1, links=0.16)


def predicted_mm(name: str, sizes: ErrorSizes, along: Trajectory = LEANING) -> float:
    """Rms of what the arm's errors leave at the target; joints rest on the same side everywhere."""
    arm = replace(ARM, sizes=sizes)
    at_target = target_pose(along, ROOM)
    poses = strategy_named(name).localization_poses(along, FIDUCIALS, ROOM, arm)
    spheres, tip = ROOM.apply(FIDUCIALS), ROOM.apply(along.target_mm)
    looks = np.array([arm.stereo_at(pose) for pose in poses])
    sources = arm_sources(
        arm.kinematics.chain,
        ArmPoses(looks, spheres, np.ones((len(looks), 6))),
        ArmPoses(np.array([arm.guide_at(at_target)]), tip[None], np.ones((1, 6))),
        sizes,
    )
    return predict_target_error(spheres, tip, sources).rms_mm


@pytest.mark.parametrize("sizes", [ErrorSizes(), CALIBRATED], ids=["set S", "calibrated"])
def test_improved_jdms_predicts_less_error_than_jdms_and_ocs(sizes: ErrorSizes) -> None:
    assert predicted_mm("improved", sizes) < min(predicted_mm("jdms", sizes), predicted_mm("ocs", sizes))


@pytest.mark.parametrize("beyond_mm", [-90.0, 60.0], ids=["held back", "held in"])
def test_with_the_guide_held_elsewhere_on_the_axis_the_error_at_the_target_is_optimized(
    beyond_mm: float,
) -> None:
    held, sizes = LEANING.held(beyond_mm), ErrorSizes(tool_mm=0.0)
    arm = replace(ARM, sizes=sizes)
    at_target = np.array([arm.guide_at(target_pose(held, ROOM))])
    wanted = displacements(KR6.chain, at_target, ROOM.apply([held.target_mm]), sizes)

    def unlike_mm(name: str) -> float:
        poses = strategy_named(name).localization_poses(held, FIDUCIALS, ROOM, arm)
        looks = np.array([arm.stereo_at(pose) for pose in poses])
        there = displacements(KR6.chain, looks, ROOM.apply(FIDUCIALS), sizes)
        links, joints = there.links_mm - wanted.links_mm, there.joints_mm - wanted.joints_mm
        return float(np.sqrt(np.sum(links**2) + np.sum(joints**2)))

    assert unlike_mm("improved") < min(unlike_mm("jdms"), unlike_mm("ocs"))


def test_with_only_a_tool_frame_error_the_orientation_is_that_of_the_target() -> None:
    arm = replace(ARM, sizes=ErrorSizes(tool_mm=2.0, links=0.0, joints=0.0, backlash=0.0))
    wanted = target_pose(LEANING, ROOM).rotation_matrix
    for pose, fiducial in zip(
        strategy_named("improved").localization_poses(LEANING, FIDUCIALS, ROOM, arm), FIDUCIALS, strict=True
    ):
        np.testing.assert_allclose(pose.rotation_matrix, wanted, atol=1e-4)
        np.testing.assert_allclose(pose.translation_mm, ROOM.apply(fiducial), atol=1e-6)


def test_best_localizes_with_the_strategy_chosen_for_each_trajectory() -> None:
    best = BestOfEach(others={LEANING.identifier: strategy_named("ocs")})
    other = replace(LEANING, identifier="T2")
    for along, name in ((LEANING, "ocs"), (other, "improved")):
        expected = strategy_named(name).localization_poses(along, FIDUCIALS, ROOM, ARM)
        for pose, wanted in zip(best.localization_poses(along, FIDUCIALS, ROOM, ARM), expected, strict=True):
            np.testing.assert_array_equal(pose.rotation_matrix, wanted.rotation_matrix)
