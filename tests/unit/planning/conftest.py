"""A small valid plan, a CT that holds it, and an arm over a head, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.reach.visits import ArmSetting
from procedures.strategies.catalogue import strategy_named
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900
from ronna_hw.frames import Frame, Transform

SERIES = "1.2.826.0.1.3680043.8.498.7"
PLAN = f"""
schema = 1
series_instance_uid = "{SERIES}"
patient_orientation = "HFS"
implanted = 4
fiducials = "free"
tool = "guide"
standoff_mm = 30.0
instrument_length_mm = 250.0

[[trajectories]]
id = "T1"
entry_mm = [10.0, -50.0, 60.0]
target_mm = [5.0, -20.0, 20.0]
margin_mm = 1.5

[[trajectories]]
id = "T2"
entry_mm = [-20, -40, 70]
target_mm = [-15.5, -10.0, 25.0]
free_angle_deg = 30.0
margin_mm = 2.0
"""


@pytest.fixture
def plan_text() -> str:
    return PLAN


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
            "series_instance_uid": SERIES,
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
        fields = {
            "kinematics": kr6_r900(ArmVariant.SIXX),
            "robot_from_ct": Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_components(head_mm, axes)),
            "flange_from_tool": Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(220.0, 0.0, 60.0)),
            "strategy": strategy_named("ocs"),
            "start_rad": radians6(0.0, -90.0, 90.0, 0.0, 90.0, 0.0),
        }
        return ArmSetting(**{**fields, **changes})

    return make
