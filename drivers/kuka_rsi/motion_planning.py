"""Plans the motions of one arm: within its limits and mode, and clear of its surroundings."""

from __future__ import annotations

from dataclasses import replace
from math import radians

from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.preview import PathPreview, plan_motion, preview_motion, with_speed_steps
from ronna_hw.devices.readings import JointVector
from ronna_hw.devices.robot import Motion, OperatingMode


class MotionPlanner:
    """`surroundings` may be replaced between motions."""

    def __init__(self, name: str, kinematics: Kinematics, options: KukaOptions, cycle_s: float) -> None:
        self._name = name
        self._kinematics = kinematics
        limits = working_limits(kinematics, options.speed_fraction)
        self._limits = replace(
            limits,
            cycle_s=cycle_s,
            range_margin_rad=radians(options.range_margin_deg),
            line_speed_mm_s=options.line_speed_mm_s or limits.line_speed_mm_s,
        )
        self.surroundings = Surroundings()

    def limits(self, mode: OperatingMode) -> MotionLimits:
        """Limits of every motion in an operating mode."""
        if mode is OperatingMode.REDUCED_SPEED:
            return self._limits.at_reduced_speed(self._kinematics)
        return self._limits

    def plan(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> MotionPlan:
        """The path of a motion from `start_rad`; raises the errors of `plan_motion`."""
        return plan_motion(self._kinematics, start_rad, motion, self.limits(mode))

    def clear(self, plan: MotionPlan, link: LinkClient, mode: OperatingMode) -> MotionPlan:
        """The plan with its speed limits along the path, if nothing comes too close; raises ARM-007."""
        if self.surroundings != link.surroundings:  # the real-time process reads only changes
            link.surroundings = self.surroundings
        path = sweep_path(self._kinematics, plan, link.surroundings)
        path.require(f"the path of {self._name}")
        return with_speed_steps(plan, path, self.limits(mode).body_speed_mm_s)

    def preview(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> PathPreview:
        """What `plan` and `clear` would make the arm do; raises the errors of `plan`."""
        return preview_motion(self._kinematics, start_rad, motion, self.surroundings, self.limits(mode))
