"""The arm as a procedure may see it."""

from __future__ import annotations

from typing import Protocol

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.readings import ArmReading


class ArmView(Protocol):
    """What a procedure may know of the arm; what moves it are the calls of the workcell."""

    @property
    def kinematics(self) -> Kinematics:
        """As `RobotArm.kinematics`."""
        ...

    def observe(self) -> LastKnown[ArmReading]:
        """As `RobotArm.observe`."""
        ...
