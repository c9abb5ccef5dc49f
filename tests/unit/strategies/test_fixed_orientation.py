"""OCS: the tool axis on the trajectory, one orientation for fiducials and target."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import ARM

from procedures.strategies.errors import BAD_TRAJECTORY
from procedures.strategies.fixed_orientation import NeutralOrientation, OrientationCorrection
from procedures.strategies.trajectory import (
    Trajectory,
    back_along_axis,
    reference_direction,
    refine_target_pose,
    target_pose,
    turn_onto,
)
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform

OCS = OrientationCorrection()
FIDUCIALS = [[60.0, -30.0, 80.0], [-50.0, -40.0, 85.0], [0.0, 60.0, 95.0]]


def room(seed: int = 3) -> Transform:
    rotation = Rotation.from_euler("ZYX", [1.4, -0.3, 2.6]) * Rotation.random(rng=seed) ** 0.1
    return Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_components([640.0, 50.0, 250.0], rotation))


def trajectory(free_angle_rad: float = 0.0) -> Trajectory:
    return Trajectory("T1", (20.0, -60.0, 70.0), (5.0, -10.0, 20.0), free_angle_rad)


def test_the_tool_axis_runs_from_entry_to_target_and_the_tip_is_at_the_target():
    pose = target_pose(trajectory(), room())
    assert (pose.target, pose.source) == (Frame.ROBOT, Frame.TOOL)
    assert np.allclose(pose.apply([0, 0, 0]), room().apply(trajectory().target_mm))
    assert np.allclose(pose.apply([0, 0, -trajectory().depth_mm]), room().apply(trajectory().entry_mm))


def test_at_free_angle_zero_tool_x_is_as_radial_as_the_axis_allows():
    pose = target_pose(trajectory(), room())
    origin, (x, _, z) = pose.translation_mm, pose.rotation_matrix.T
    radial = np.array([origin[0], origin[1], 0.0]) / np.hypot(origin[0], origin[1])
    turns = np.radians(np.arange(0.0, 360.0, 0.5))
    others = [math.cos(a) * x + math.sin(a) * np.cross(z, x) for a in turns]
    assert max(other @ radial for other in others) == pytest.approx(x @ radial)


def test_the_free_angle_turns_right_handed_about_tool_z():
    zero, turned = target_pose(trajectory(), room()), target_pose(trajectory(0.5), room())
    relative = (zero.inverse() @ Transform(Frame.ROBOT, Frame.TOOL, turned.rigid)).rigid
    assert np.allclose(relative.rotation.as_rotvec(), [0.0, 0.0, 0.5])
    assert np.allclose(relative.translation, 0.0, atol=1e-9)


def test_every_fiducial_is_localized_in_the_orientation_of_the_target():
    poses, target = (
        OCS.localization_poses(trajectory(0.3), FIDUCIALS, room(), ARM),
        target_pose(trajectory(0.3), room()),
    )
    assert len(poses) == 3
    for pose, fiducial in zip(poses, FIDUCIALS, strict=True):
        assert np.allclose(pose.translation_mm, room().apply(fiducial))
        assert np.allclose(pose.rotation_matrix, target.rotation_matrix)


def test_a_refined_registration_adds_no_turn_about_the_axis():
    coarse = room()
    small = RigidTransform.from_components([0.4, -0.2, 0.3], Rotation.from_rotvec([0.004, -0.003, 0.006]))
    fine = Transform(Frame.ROBOT, Frame.CT, small * coarse.rigid)
    localized = OCS.localization_poses(trajectory(0.3), FIDUCIALS, coarse, ARM)[0]
    pose = refine_target_pose(localized, trajectory(0.3), fine)
    axis = fine.rotation_matrix @ trajectory().axis_ct
    assert np.allclose(pose.rotation_matrix[:, 2], axis)
    change = (pose.rigid.rotation * localized.rigid.rotation.inv()).as_rotvec()
    assert abs(change @ axis) < 1e-4
    assert np.allclose(pose.translation_mm, fine.apply(trajectory().target_mm))


def test_the_same_axis_needs_no_turn():
    orientation = target_pose(trajectory(), room()).rigid.rotation
    unchanged = turn_onto(orientation, orientation.as_matrix()[:, 2])
    assert (unchanged.inv() * orientation).magnitude() < 1e-12


@pytest.mark.parametrize(
    ("axis", "at_mm", "expected"),
    [
        ([0.0, 0.0, -1.0], [500.0, 0.0, 300.0], [1.0, 0.0, 0.0]),
        ([0.0, 0.0, -1.0], [0.0, -400.0, 300.0], [0.0, -1.0, 0.0]),
        ([1.0, 0.0, 0.0], [500.0, 0.0, 300.0], [0.0, 0.0, 1.0]),  # radial axis: robot z instead
        ([0.0, 0.0, -1.0], [0.0, 0.0, 900.0], [1.0, 0.0, 0.0]),  # on the base axis: robot x instead
    ],
)
def test_the_reference_direction_is_defined_everywhere(axis, at_mm, expected):
    assert np.allclose(reference_direction(np.array(axis), np.array(at_mm)), expected)


def test_the_approach_point_lies_back_along_the_tool():
    pose = target_pose(trajectory(), room())
    back = back_along_axis(pose, 60.0)
    assert np.allclose(back.translation_mm, pose.translation_mm - 60.0 * pose.rotation_matrix[:, 2])
    assert np.allclose(back.rotation_matrix, pose.rotation_matrix)


def test_wrong_frames_are_refused():
    for refused in (
        lambda: target_pose(trajectory(), room().inverse()),
        lambda: refine_target_pose(room(), trajectory(), room()),
        lambda: NOS.localized_along((LEANING,), FIDUCIALS, ROOM.inverse()),
    ):
        with raises(FRAME_MISMATCH, match="FRM-001"):
            refused()


@pytest.mark.parametrize(
    "numbers",
    [
        ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), 0.0),
        ((1.0, 2.0, math.nan), (1.0, 2.0, 30.0), 0.0),
        ((1.0, 2.0, 3.0), (1.0, 2.0, 30.0), math.inf),
        ((1.0, 2.0), (1.0, 2.0, 30.0), 0.0),
        ((1.0, 2.0, "3"), (1.0, 2.0, 30.0), 0.0),
        ((1.0, 2.0, 3.0), (1.0, 2.0, 30.0), 30.0),  # degrees
    ],
)
def test_a_trajectory_without_direction_is_refused(numbers):
    with raises(BAD_TRAJECTORY, match="STR-003"):
        Trajectory("T1", *numbers)


NOS = NeutralOrientation()
ROOM = Transform(
    Frame.ROBOT,
    Frame.CT,
    RigidTransform.from_components([640.0, 50.0, 250.0], Rotation.from_euler("ZYX", [1.4, -0.3, 2.6])),
)
LEANING = Trajectory("T1", (20.0, -60.0, 70.0), (5.0, -10.0, 20.0), 0.4)
OTHER = Trajectory("T2", (-30.0, -40.0, 90.0), (-5.0, -10.0, 20.0))


def test_all_fiducials_are_localized_with_the_tool_pointing_down_and_x_away_from_the_base():
    (axis,) = NOS.localized_along((LEANING, OTHER), FIDUCIALS, ROOM)
    poses = NOS.localization_poses(axis, FIDUCIALS, ROOM, ARM)
    middle = ROOM.apply(np.mean(FIDUCIALS, axis=0))
    radial = np.array([*middle[:2], 0.0]) / np.hypot(*middle[:2])
    for pose, fiducial in zip(poses, FIDUCIALS, strict=True):
        assert np.allclose(pose.translation_mm, ROOM.apply(fiducial))
        assert np.allclose(pose.rotation_matrix[:, 2], [0.0, 0.0, -1.0])
        assert np.allclose(pose.rotation_matrix[:, 0], radial)


def test_the_orientation_depends_on_the_fiducials_alone():
    assert NOS.localized_along((LEANING,), FIDUCIALS, ROOM) == NOS.localized_along((OTHER,), FIDUCIALS, ROOM)
    assert NOS.localized_along((LEANING,), np.zeros((0, 3)), ROOM) == ()
