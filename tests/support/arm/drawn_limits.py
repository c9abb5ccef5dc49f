"""Theatre limits drawn at random, and a driver that carries out what the path check accepted with them."""

from __future__ import annotations

import random

import numpy as np

from drivers.kuka_rsi.options import LARGEST_SPEED_FRACTION, KukaOptions
from procedures.planning.motions import Motion
from ronna_hw.arm.clearance.bodies import Bodies
from ronna_hw.arm.clearance.sweep import moving_ends
from ronna_hw.arm.kr6_r900 import Kr6R900
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm_stream.motion import MotionPlanner
from ronna_hw.arm_stream.records import Choice
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.devices import JointMove, LineMove
from ronna_hw.devices import Motion as DeviceMotion
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.frames import Frame, Transform


def drawn_options(rng: random.Random) -> KukaOptions:
    """Any limits that a theatre file may set; every second set keeps a usual margin."""
    return KukaOptions(
        speed_fraction=rng.uniform(0.02, 0.999 * LARGEST_SPEED_FRACTION),
        range_margin_deg=rng.choice((rng.uniform(0.0, 2.0), rng.uniform(0.0, 30.0), 30.0)),
        line_speed_mm_s=rng.choice((None, rng.uniform(5.0, 250.0))),
        cycle_ms=rng.choice((4, 12)),
    )


class LimitedDriver:
    """The driver's planner and its real-time set-points, in process, with the limits of a theatre file."""

    def __init__(self, arm: Kr6R900, options: KukaOptions, mode: OperatingMode) -> None:
        self.arm = arm
        self.mode = mode
        cycle_s = (options.cycle_ms or 4) / 1000.0
        self.planner = MotionPlanner("robot.master", arm, options.limits(arm, cycle_s))
        self.limits = self.planner.limits(mode)

    def planned(self, motion: Motion) -> MotionPlan:
        """As for a request of the workcell; raises what the driver raises."""
        self.planner.surroundings = motion.around
        plan = self.planner.plan(self._request(motion), motion.plan.start_rad, self.mode)
        return self.planner.clear_plan(plan, self.mode)

    def driven(self, motion: Motion) -> tuple[float, float]:
        """Duration (s) and largest speed of any body (mm/s) of all that is sent, as judged by the monitor."""
        plan = self.planned(motion)
        cycle_s = self.limits.cycle_s
        points = SetPoints(self.arm, self.limits, cycle_s, plan.start_rad)
        points.start(plan, 1.0, motion.around)
        sent = [plan.start_rad]
        points.prepare()
        while points.moving:
            assert points.violation is None, str(points.violation)
            points.commit(Choice.GO)
            sent.append(points.last_rad)
            points.prepare()
        ends = moving_ends(Bodies(self.arm, motion.around), np.array(sent))
        speeds = np.linalg.norm(np.diff(ends, axis=0), axis=-1) / cycle_s
        return (len(sent) - 1) * cycle_s, float(speeds.max(initial=0.0))

    def _request(self, motion: Motion) -> DeviceMotion:
        plan = motion.plan
        if plan.target is None:
            return JointMove(plan.target_rad)
        flange = plan.target.to_transform()
        tool = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=plan.tool_in_flange_mm)
        return LineMove(flange @ tool, tool, motion.speed_fraction)
