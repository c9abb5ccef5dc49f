"""A small valid plan, a CT that holds it, and an arm over a head, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from half_sitting import arm_setting
from painted_ct import SERIES_UID
from plan_toml import PLAN, SECOND
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.visits import ArmSetting
from ronna_hw.arm.pose import radians6
from ronna_hw.frames import Frame, Transform


@pytest.fixture
def plan_text() -> str:
    return PLAN + SECOND


@pytest.fixture
def plan_path(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a plan file with this content."""

    def write(text: str) -> Path:
        path = tmp_path / "plan.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def make_volume() -> Callable[..., Volume]:
    """A CT of 200 mm cubed around the origin: tissue below a slanting plane, air above it.

    The entries of the plan lie at the plane. Options replace fields.
    """

    def make(**changes: Any) -> Volume:
        geometry = VoxelGeometry(
            shape=(20, 20, 20),
            origin_mm=np.array([-95.0, -95.0, -95.0]),
            axes=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
            spacing_mm=np.array([10.0, 10.0, 10.0]),
        )
        z, y, _ = np.meshgrid(*[np.arange(-95.0, 100.0, 10.0)] * 3, indexing="ij")
        fields = {
            "voxels": np.where(0.8 * z - 0.6 * y < 79.0, 40, -1000).astype(np.int16),
            "geometry": geometry,
            "series_instance_uid": SERIES_UID,
            "frame_of_reference_uid": "1.2.3",
            "patient_position": "HFS",
        }
        return Volume(**{**fields, **changes})

    return make


@pytest.fixture
def make_arm() -> Callable[..., ArmSetting]:
    """An arm beside a head whose CT origin lies at `head_mm` in the robot frame."""

    def make(head_mm: tuple[float, float, float] = (640.0, 0.0, 250.0), **changes: Any) -> ArmSetting:
        # CT left towards robot y, CT anterior up, CT superior towards the robot.
        axes = Rotation.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        at = Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_components(head_mm, axes))
        fields = {"start_rad": radians6(0.0, -90.0, 90.0, 0.0, 90.0, 0.0), "scene": None, **changes}
        return arm_setting(**{"robot_from_ct": at, **fields})

    return make
