"""An arm in process that previews, plans and checks every motion by the driver's own planner."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from recording_cell import RecordingArm

from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm_stream.motion import MotionPlanner
from ronna_hw.devices import Motion
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.vectors import JointVector

CYCLE_S = 0.004


@dataclass
class PlannedArm(RecordingArm):
    """Arrives at once; `plans` are what it drove."""

    plans: list[MotionPlan] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.planner = MotionPlanner(
            self.name, self.kinematics, KukaOptions().limits(self.kinematics, CYCLE_S)
        )

    @property
    def surroundings(self) -> Surroundings:
        return self.planner.surroundings

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        return self.planner.limits(mode or self.operating_mode)

    def surround(self, surroundings: object) -> None:
        assert isinstance(surroundings, Surroundings)
        self.planner.surroundings = surroundings

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        return self.planner.preview(motion, start_rad or self.joints_rad, self.operating_mode)

    def move(self, motion: Motion, **_more: Any) -> ArmReading:
        plan = self.planner.plan(motion, self.joints_rad, self.operating_mode)
        return self._follow(self.planner.clear_plan(plan, self.operating_mode))

    def _follow(self, plan: MotionPlan) -> ArmReading:
        if self.interruptions:
            self.interruptions -= 1
            self.state = Lifecycle.HOLD
            self.joints_rad = plan.path(self.kinematics).joints(0.5, plan.start_rad)
            raise MotionInterrupted("stopped half way")
        self.plans.append(plan)
        self.joints_rad = plan.target_rad
        return self.read_state()
