"""The arm as a procedure may see it: an object of its own, so that nobody finds the arm itself in it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.devices import RobotArm
from ronna_hw.devices.lifecycle import Identity, LastKnown, Lifecycle
from ronna_hw.devices.readings import ArmReading

AT_PLACE_RAD = math.radians(0.1)  # far more than the arm's repeatability, far less than any way


class ArmView:
    """A `DeviceView` with its kinematics and limits; what moves the arm are the calls of the workcell."""

    def __init__(self, arm: RobotArm) -> None:
        self._arm = arm

    @property
    def kinematics(self) -> Kinematics:
        """As `RobotArm.kinematics`."""
        return self._arm.kinematics

    def limits(self) -> MotionLimits:
        """Limits of every motion in the arm's present operating mode."""
        return self._arm.limits()

    @property
    def state(self) -> Lifecycle:
        """As `Device.state`."""
        return self._arm.state

    @property
    def notices(self) -> tuple[str, ...]:
        """As `Device.notices`."""
        return self._arm.notices

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """As `Device.connect`."""
        return self._arm.connect(timeout_s)

    def configure(self, timeout_s: float = 10.0) -> None:
        """As `Device.configure`."""
        self._arm.configure(timeout_s)

    def observe(self) -> LastKnown[ArmReading]:
        """As `RobotArm.observe`."""
        return self._arm.observe()


def stands_at(
    joints_rad: Sequence[float], place_rad: Sequence[float], within_rad: float = AT_PLACE_RAD
) -> bool:
    """Whether every joint is nearer than that to where it is in a place."""
    return all(abs(here - there) < within_rad for here, there in zip(joints_rad, place_rad, strict=True))
