"""A well-behaved arm that exists only in the tests: a UR5 with its offset wrist, and no wire."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import ClassVar

from ideal_device import IdealDevice

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import READABLE, RUNNING, Identity, Lifecycle, require_person
from ronna_hw.devices.readings import ArmReading, LinkStatistics, Stamp, ToolIdentity, Validity
from ronna_hw.devices.robot import Motion, OperatingMode, StopKind
from ronna_hw.errors import ConnectError
from ronna_hw.preview import plan_motion, preview_motion
from ronna_hw.vectors import JointVector

STEPS = 20  # of any motion
STEP_S = 0.002


class Nobody(ConnectError):
    """Nothing is at the address."""

    code = "TST-001"
    action = "Look for it."


class Stopped(MotionInterrupted):
    """A stop ended the motion."""

    code = "TST-002"
    action = "Resume, or recover."


@dataclass
class Controller:
    """What the controller knows whoever talks to it."""

    joints_rad: JointVector = universal_robot("ur5").home_rad
    cycles: int = 0


class IdealArm(IdealDevice):
    """Does what the interface says, in a few steps, at `host:`. A subclass holds the controller."""

    controller: ClassVar[Controller]
    kinematics = universal_robot("ur5")
    operating_mode = OperatingMode.AUTOMATIC

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, known=set())
        self.surroundings = Surroundings()
        self.halted = threading.Event()
        self._under_way = threading.Lock()

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        limits = working_limits(self.kinematics)
        reduced = (mode or self.operating_mode) is OperatingMode.REDUCED_SPEED
        return limits.with_reduced_speed(self.kinematics) if reduced else limits

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.guard.require("connect", {Lifecycle.DISCONNECTED})
        if self.config.endpoint != "host:":
            raise Nobody("nobody is there")
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Test", self.kinematics.name, "1", "0")

    def activate(self, timeout_s: float = 10.0) -> None:
        super().activate()
        self.halted.clear()

    def deactivate(self, timeout_s: float = 10.0) -> None:
        self.guard.require("deactivate", RUNNING)
        self.guard.enter(Lifecycle.CONFIGURED)
        self._come_to_rest()

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        self.guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        self.guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        super().close()
        self._come_to_rest()

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        self.guard.require("read_state", READABLE)
        stamp, joints_rad = self._stamp(), self.controller.joints_rad
        commanded_rad = joints_rad if self.state in RUNNING else None
        self.newest = ArmReading(stamp, Validity.OK, joints_rad, commanded_rad, self._under_way.locked())
        return self.newest

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        self.guard.require("read_tool_identity", READABLE)
        return ToolIdentity(self._stamp(), 0)

    def read_loads(self, cycles: int = LOAD_CYCLES, timeout_s: float = 2.0) -> AxisLoads:
        self.guard.require("read_loads", RUNNING)
        stamp, joints_rad = self._stamp(), self.controller.joints_rad
        return AxisLoads(stamp, Validity.OK, joints_rad, cycles, current_A=(1.0,) * 6)

    def link_statistics(self) -> LinkStatistics:
        self.controller.cycles += 1  # whenever anyone looks, another has come
        cycles = self.controller.cycles
        return LinkStatistics(cycles, 0, 0, 0, 1.0, 2.0, (0.0, 1000.0), (cycles,))

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        here_rad = start_rad or self.controller.joints_rad
        return preview_motion(self.kinematics, here_rad, motion, self.surroundings, self.limits())

    def surround(self, surroundings: Surroundings) -> None:
        self.surroundings = surroundings

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        self.guard.require("stop", RUNNING)
        if kind is StopKind.HOLD:
            self.guard.enter(Lifecycle.HOLD)
        else:
            self.guard.latch(Stopped(f"stopped by {kind}"))
        self._come_to_rest()

    def resume(self) -> None:
        self.guard.require("resume", {Lifecycle.HOLD})
        self.halted.clear()
        self.guard.enter(Lifecycle.ACTIVE)

    def move(self, motion: Motion, *, timeout_s: float = 60.0) -> ArmReading:
        self.guard.require("move", {Lifecycle.ACTIVE})
        plan = plan_motion(self.kinematics, self.controller.joints_rad, motion, self.limits())
        sweep_path(self.kinematics, plan, self.surroundings).require("the path")
        path = plan.path(self.kinematics)
        with self._under_way:
            for step in range(1, STEPS + 1):
                if self.halted.wait(STEP_S):
                    raise Stopped("stopped on the way")
                self.controller.joints_rad = path.joints(step / STEPS, self.controller.joints_rad)
        return self.read_state()

    def _come_to_rest(self) -> None:
        self.halted.set()
        with self._under_way:
            pass

    def _stamp(self) -> Stamp:
        self.controller.cycles += 1
        return Stamp(self.controller.cycles, self.controller.cycles, self.clock.now_s())
