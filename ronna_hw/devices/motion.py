"""A motion of an arm as a value: the motion previewed is the motion driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ronna_hw.devices.readings import ArmReading, JointVector

if TYPE_CHECKING:
    from ronna_hw.devices.robot import RobotArm
    from ronna_hw.frames import Transform


@dataclass(frozen=True)
class JointMove:
    """All joints straight to `target_rad`, together.

    `speed_fraction` is a fraction of the driver's working speed, 0 < fraction <= 1.
    """

    target_rad: JointVector
    speed_fraction: float = 1.0

    def drive(self, arm: RobotArm) -> ArmReading:
        """Like `RobotArm.move_joints`."""
        return arm.move_joints(self.target_rad, speed_fraction=self.speed_fraction)


@dataclass(frozen=True)
class LineMove:
    """A straight line of the flange to ROBOT <- FLANGE, or of the tool to ROBOT <- TOOL.

    `flange_from_tool` (FLANGE <- TOOL) is given with the latter. `speed_fraction` as in `JointMove`.
    """

    target: Transform
    flange_from_tool: Transform | None = None
    speed_fraction: float = 1.0

    def drive(self, arm: RobotArm) -> ArmReading:
        """Like `RobotArm.move_linear`."""
        return arm.move_linear(
            self.target, flange_from_tool=self.flange_from_tool, speed_fraction=self.speed_fraction
        )


Motion = JointMove | LineMove
