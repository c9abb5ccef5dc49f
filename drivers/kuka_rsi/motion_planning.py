"""Plans the motions of one arm: within its limits and mode, and clear of its surroundings."""

from __future__ import annotations

from dataclasses import replace
from math import radians

from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.arm.clearance.swept_path import sweep_path
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.line_target import LineTarget
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.speed_zones import with_speed_steps
from ronna_hw.arm.preview import PathPreview, preview
from ronna_hw.devices.readings import JointVector
from ronna_hw.wire.kuka_eki import OperationMode


class MotionPlanner:
    """`surroundings` may be replaced between motions."""

    def __init__(self, name: str, kinematics: Kinematics, options: KukaOptions) -> None:
        self._name = name
        self._kinematics = kinematics
        limits = working_limits(kinematics, options.speed_fraction)
        self._limits: MotionLimits = replace(
            limits,
            range_margin_rad=radians(options.range_margin_deg),
            line_speed_mm_s=options.line_speed_mm_s or limits.line_speed_mm_s,
        )
        self.surroundings = Surroundings()

    def limits(self, mode: OperationMode, speed_fraction: float = 1.0) -> MotionLimits:
        """Motion limits in an operating mode; raises ARM-006 for an invalid fraction."""
        limits = self._limits
        if mode is OperationMode.T1:
            limits = limits.at_reduced_speed(self._kinematics)
        return limits.slowed(speed_fraction)

    def clear(self, plan: MotionPlan, link: LinkClient, mode: OperationMode) -> MotionPlan:
        """The plan with its speeds by place, when nothing on its way comes too near; raises ARM-007."""
        around = self._around(self.limits(mode))
        if around != link.surroundings:  # the real-time process reads what is new only
            link.surroundings = around
        path = sweep_path(self._kinematics, plan, link.surroundings)
        path.require(f"the path of {self._name}")
        return with_speed_steps(plan, path)

    def preview(
        self, start_rad: JointVector, target: JointVector | LineTarget, limits: MotionLimits
    ) -> PathPreview:
        """What a joint move, or a line to a pose, would do; raises where there is no such path."""
        if isinstance(target, LineTarget):
            plan = plan_line(self._kinematics, start_rad, target.flange, limits, target.point_in_flange_mm)
        else:
            plan = plan_joint_move(self._kinematics, start_rad, target, limits)
        return preview(self._kinematics, plan, self._around(limits), limits)

    def _around(self, limits: MotionLimits) -> Surroundings:
        return replace(self.surroundings, most_mm_s=limits.body_speed_mm_s)
