"""A KR 6 R900 before a head in a half sitting position, and a plan for it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import HOME_RAD, KR6, TOOL

from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.scene import PlanningScene
from procedures.planning.visits import ArmSetting
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.collision_config import CollisionConfig, RoomBody
from ronna_hw.frames import Frame, Transform

HEAD = HeadEllipsoid(centre_mm=(3.2, -41.7, 812.4), semi_axes_mm=(78.0, 98.0, 93.0))
FIDUCIALS = ((-20.0, -110.0, 880.0), (64.0, -75.0, 880.0), (5.0, -60.0, 915.0))
HELD_MM = 55.0  # beyond the entry the tip frame of a guide of 85 mm reach that is held 30 mm outside
TRAJECTORIES = tuple(
    one.with_rest(HELD_MM - one.depth_mm)
    for one in (
        Trajectory("T1", (10.0, -112.0, 872.0), (5.0, -70.0, 838.0)),
        Trajectory("T2", (30.0, -100.0, 880.0), (18.0, -62.0, 845.0)),
    )
)
# Left towards robot y, the vertex up and towards the robot, the face up.
LEFT, SUPERIOR = np.array([0.0, 1.0, 0.0]), np.array([-0.5, 0.0, math.sqrt(0.75)])
RECLINED = Rotation.from_matrix(np.column_stack([LEFT, np.cross(SUPERIOR, LEFT), SUPERIOR]))
MIDDLE_MM = (760.0, 0.0, 200.0)
CAMERA_MM = 250.0 * np.array([0.0, math.sin(math.radians(27.5)), -math.cos(math.radians(27.5))])
SIGHT = StereoSight(left_mm=CAMERA_MM * (1.0, -1.0, 1.0), right_mm=CAMERA_MM)


def reclined_ct(centre_mm: ArrayLike = HEAD.centre_mm, middle_mm: ArrayLike = MIDDLE_MM) -> Transform:
    """Robot from the CT of a head whose centre is there in the CT, and in the middle of the robot's room."""
    origin_mm = np.asarray(middle_mm) - RECLINED.apply(centre_mm)
    return Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_components(origin_mm, RECLINED))


def scene_with(*bodies: RoomBody) -> PlanningScene:
    """Build the surroundings of the half-sitting head: its spheres, a usual cell, and these bodies."""
    return PlanningScene(CollisionConfig(bodies=(*CollisionConfig().bodies, *bodies)), HEAD, FIDUCIALS)


def arm_setting(robot_from_ct: Transform | None = None, **changes: Any) -> ArmSetting:
    """The arm before that head, or before a CT elsewhere; `changes` replace fields."""
    fields = {
        "kinematics": KR6,
        "limits": working_limits(KR6),
        "flange_from_tool": TOOL,
        "strategy": find_strategy("ocs"),
        "start_rad": HOME_RAD,
        "scene": scene_with(),
    }
    return ArmSetting(robot_from_ct=robot_from_ct or reclined_ct(), **{**fields, **changes})
