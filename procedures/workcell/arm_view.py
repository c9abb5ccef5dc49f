"""The arm as a procedure may see it."""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.devices import RobotArm
from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.readings import ArmReading


class ArmView:
    """What a procedure may know of the arm; what moves it are the calls of the workcell."""

    def __init__(self, arm: RobotArm) -> None:
        self._arm = arm

    @property
    def kinematics(self) -> Kinematics:
        """As `RobotArm.kinematics`."""
        return self._arm.kinematics

    def observe(self) -> LastKnown[ArmReading]:
        """As `RobotArm.observe`."""
        return self._arm.observe()


def stands_at(joints_rad: Sequence[float], place_rad: Sequence[float], within_rad: float) -> bool:
    """Whether every joint is nearer than that to where it is in a place."""
    return all(abs(here - there) < within_rad for here, there in zip(joints_rad, place_rad, strict=True))
