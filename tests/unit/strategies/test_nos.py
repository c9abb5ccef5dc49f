"""NOS: one orientation for all fiducials, whatever the trajectories."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import ARM

from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Frame, FrameMismatch, Transform

NOS = NeutralOrientation()
FIDUCIALS = [[60.0, -30.0, 80.0], [-50.0, -40.0, 85.0], [0.0, 60.0, 95.0]]
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


def test_the_orientation_does_not_depend_on_the_trajectories():
    assert NOS.localized_along((LEANING,), FIDUCIALS, ROOM) == NOS.localized_along((OTHER,), FIDUCIALS, ROOM)


def test_without_fiducials_there_is_no_localization_axis():
    assert NOS.localized_along((LEANING,), np.zeros((0, 3)), ROOM) == ()


def test_wrong_frames_are_refused():
    with pytest.raises(FrameMismatch, match="FRM-001"):
        NOS.localized_along((LEANING,), FIDUCIALS, ROOM.inverse())
