"""The arm as a strategy needs it: kinematics, mounted tools, working branch, remaining errors."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.calibration.arm_sources import UNCALIBRATED, ErrorSizes
from procedures.strategies.orientation import require_frames
from ronna_hw.arm.kinematics import Branch, Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Frame, Transform

Joints = tuple[float, float, float, float, float, float]  # rad


@dataclass(frozen=True)
class ArmInBranch:
    """Nominal kinematics; guide and stereo head as FLANGE <- TOOL; reference for whole turns.

    `sizes` are those of the arm's remaining errors.
    """

    kinematics: Kinematics
    flange_from_guide: Transform
    flange_from_stereo: Transform
    branch: Branch
    near_rad: Joints
    sizes: ErrorSizes = UNCALIBRATED

    def __post_init__(self) -> None:
        """Raises FRM-001 when a tool is not FLANGE <- TOOL."""
        require_frames(self.flange_from_guide, Frame.FLANGE, Frame.TOOL)
        require_frames(self.flange_from_stereo, Frame.FLANGE, Frame.TOOL)

    def guide_at(self, pose: Transform) -> Joints:
        """Joints that bring the guide to a pose ROBOT <- TOOL; raises ARM-001 to ARM-003."""
        flange = Pose.from_transform(pose @ self.flange_from_guide.inverse())
        return self.kinematics.solve_branch(flange, self.branch, self.near_rad)

    def stereo_at(self, pose: Transform) -> Joints:
        """The same for the stereo head."""
        flange = Pose.from_transform(pose @ self.flange_from_stereo.inverse())
        return self.kinematics.solve_branch(flange, self.branch, self.near_rad)

    def stereo_pose(self, joints_rad: Joints) -> Transform:
        """The pose ROBOT <- TOOL of the stereo head at these joints."""
        return self.kinematics.flange_pose(joints_rad) @ self.flange_from_stereo
