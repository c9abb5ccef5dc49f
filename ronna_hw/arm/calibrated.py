"""The true flange pose of a calibrated arm, and the command that reaches a wanted pose.

A controller knows only the nominal chain. It is given a pose off the wanted one such that the deviations lead
to the wanted one. Deviations are small and smooth, so each iteration leaves a thousandth of the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.arm.deviations import ArmDeviations, flange_poses
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Transform

CLOSE_MM = 1e-5  # resolution of a record's numbers
CLOSE_RAD = 1e-8
MOST_ROUNDS = 8  # four suffice for an uncalibrated arm away from singularities


class Compensated(NamedTuple):
    """`joints_rad` bring the flange to the wanted pose, which the controller believes to be `commanded`."""

    joints_rad: JointVector
    commanded: Pose


class CalibratedArm:
    """An arm with its deviations; without any, exactly the nominal arm."""

    def __init__(self, nominal: Kinematics, deviations: ArmDeviations | None = None) -> None:
        self.nominal = nominal
        self._deviations = deviations

    @property
    def is_nominal(self) -> bool:
        """Whether no deviations of this arm are known."""
        return self._deviations is None

    def forward(self, joints_rad: JointVector, flanks: Sequence[float] | None = None) -> Pose:
        """Pose of the flange in the robot base.

        `flanks`, +1 or -1, give the side of its backlash on which each joint rests: the direction in which it
        arrived. Without them, each joint is assumed to be in the middle.
        """
        if self._deviations is None:
            return self.nominal.forward(joints_rad)
        sides: ArrayLike = 0.0 if flanks is None else np.asarray(flanks, dtype=float)
        pose = flange_poses(self.nominal.chain, self._deviations, joints_rad, sides)[0]
        return Pose.from_matrix(pose.tolist())

    def as_controller_sees(self, surroundings: Surroundings, at_rad: JointVector) -> Surroundings:
        """The room in the controller's own coordinates, exact at these joints.

        The controller's driver checks clearances with the nominal chain. Within reach of one head the
        deviations vary by some tenths of a millimetre, which margins and corridors allow for.
        """
        if self._deviations is None:
            return surroundings
        return surroundings.moved(self.nominal.forward(at_rad).compose(self.forward(at_rad).inverse()))

    def flange_pose(self, joints_rad: JointVector, flanks: Sequence[float] | None = None) -> Transform:
        """The same as a checked transform, ROBOT <- FLANGE."""
        return self.forward(joints_rad, flanks).to_transform()

    def compensated(
        self, flange: Transform, near: JointVector, flanks: Sequence[float] | None = None
    ) -> Compensated:
        """Joints, in the branch of `near`, that bring the flange to a pose ROBOT <- FLANGE.

        `flanks` as in `forward`, after arrival. Raises ARM-001 to ARM-003 like `Kinematics.solve_branch`;
        ARM-001 also near a singularity, where no commanded pose leads to the wanted one.
        """
        branch = self.nominal.branch_of(near)
        wanted = Pose.from_transform(flange)
        commanded = wanted
        for _ in range(MOST_ROUNDS):
            joints = self.nominal.solve_branch(commanded, branch, near)
            if self._deviations is None:
                return Compensated(joints, commanded)
            reached = self.forward(joints, flanks)
            if reached.distance_mm(wanted) < CLOSE_MM and reached.angle_rad(wanted) < CLOSE_RAD:
                return Compensated(joints, commanded)
            commanded = self.nominal.forward(joints).compose(reached.inverse()).compose(wanted)
        raise Unreachable(
            "the calibrated arm does not reach the pose exactly",
            limit=f"{CLOSE_MM} mm after {MOST_ROUNDS} rounds",
            got=f"{reached.distance_mm(wanted):.2g} mm",
        )
