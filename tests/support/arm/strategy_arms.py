"""The KR 6 R900 as strategies see it in tests, with guide and stereo head alike; a head for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.fixed_orientation import OrientationCorrection
from procedures.strategies.strategy import ArmInBranch
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.pose import radians6
from ronna_hw.frames import Frame, Transform

HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
TOOL = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(220.0, 0.0, 60.0))
KR6 = kr6_r900(SIXX)
ARM = ArmInBranch(KR6, TOOL, TOOL, KR6.branch_of(HOME_RAD), HOME_RAD)
FIDUCIALS = np.array([[60.0, -70.0, 60.0], [-50.0, -75.0, 55.0], [5.0, -40.0, 100.0]])
# CT left towards robot y, anterior up, superior towards the robot.
ROOM = Transform(
    Frame.ROBOT,
    Frame.CT,
    RigidTransform.from_components(
        [640.0, 0.0, 250.0], Rotation.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    ),
)
LEANING = Trajectory("T1", (10.0, -80.0, 60.0), (5.0, -20.0, 20.0))


@dataclass(frozen=True)
class Stuck(OrientationCorrection):
    """A strategy that serves every trajectory but one."""

    name: str = "stuck"
    on: str = ""

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Raises STR-004 along that one."""
        if along.identifier == self.on:
            raise NoNearbyJoints(f"no joints for {along.identifier}")
        return super().localization_poses(along, fiducials_mm, robot_from_ct, arm)
