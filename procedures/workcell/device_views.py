"""Views of devices for steps, guards and commands, without the methods that move an arm."""

from __future__ import annotations

from typing import Protocol

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.devices import RobotArm
from ronna_hw.devices.lifecycle import Identity, LastKnown, Lifecycle
from ronna_hw.devices.readings import ArmReading


class DeviceView(Protocol):
    """View of a `Device` that can connect and report its last known state."""

    @property
    def state(self) -> Lifecycle: ...

    @property
    def notices(self) -> tuple[str, ...]: ...

    def observe(self) -> LastKnown[object]: ...

    def connect(self, timeout_s: float = 10.0) -> Identity: ...

    def configure(self, timeout_s: float = 10.0) -> None: ...


class ArmView:
    """View of an arm without the methods that move it, which are reserved to the workcell."""

    def __init__(self, arm: RobotArm) -> None:
        self._arm = arm
        self.kinematics = arm.kinematics

    @property
    def state(self) -> Lifecycle:
        return self._arm.state

    @property
    def notices(self) -> tuple[str, ...]:
        """Notices issued by the driver in `configure`."""
        return self._arm.notices

    def limits(self) -> MotionLimits:
        return self._arm.limits()

    def observe(self) -> LastKnown[ArmReading]:
        return self._arm.observe()

    def connect(self, timeout_s: float = 10.0) -> Identity:
        return self._arm.connect(timeout_s)

    def configure(self, timeout_s: float = 10.0) -> None:
        self._arm.configure(timeout_s)
