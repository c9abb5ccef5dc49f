"""Motion planning within limits and clear of obstacles, and supervision of execution."""

from __future__ import annotations

import threading
from dataclasses import replace
from math import radians

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.errors import LinkProcessDied, MotionNotFinished, MotionRefused, MotionStopped
from drivers.kuka_rsi.fault_errors import axes_text, furthest_text, losses_text, refusal_error
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.link_client import Condition
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_state import CommandKind, LinkState, Result, StopOrder
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.devices.robot import Motion, OperatingMode
from ronna_hw.preview import plan_motion, preview_motion, with_speed_steps
from ronna_hw.vectors import JointVector

POLL_S = 0.5  # host time between checks of theatre time during a motion
SETTLE_LIMIT_S = 5.0  # theatre time at the end of the path; servos settle within a tenth of a second
STOP_S = 1.0  # host time for a motion that has used up its time to come to rest


class MotionPlanner:
    """Motion planner of one arm; `surroundings` may be replaced between motions."""

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
        """Return the motion limits for an operating mode."""
        if mode is OperatingMode.REDUCED_SPEED:
            return self._limits.with_reduced_speed(self._kinematics)
        return self._limits

    def plan(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> MotionPlan:
        """Plan a motion from `start_rad`; raises the errors of `plan_motion`."""
        return plan_motion(self._kinematics, start_rad, motion, self.limits(mode))

    def clear_plan(self, plan: MotionPlan, mode: OperatingMode) -> MotionPlan:
        """Add speed limits along the path to a plan; raises ARM-007 if clearance is violated."""
        path = sweep_path(self._kinematics, plan, self.surroundings)
        path.require(f"the path of {self._name}")
        return with_speed_steps(plan, path, self.limits(mode).body_speed_mm_s)

    def preview(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> PathPreview:
        """Plan a motion and preview its path; raises the errors of `plan`."""
        return preview_motion(self._kinematics, start_rad, motion, self.surroundings, self.limits(mode))


class MotionFollower:
    """Executor that supervises one motion at a time until the arm has settled."""

    def __init__(self, name: str, connections: Connections, watch: FaultWatch, cycle_s: float) -> None:
        self._name = name
        self._connections = connections
        self._watch = watch
        self._cycle_s = cycle_s
        self._motion_lock = threading.Lock()  # held while a motion is followed

    def follow(self, plan: MotionPlan, stop_count: int, timeout_s: float) -> LinkState:
        """Execute a plan and return the final state; more than `stop_count` stops prevent or stop it.

        Raises RSI-010 when it was stopped, also before it began, RSI-011 when it used up `timeout_s` of
        controller cycles or did not settle at the end of its path, RSI-012 when it was refused, and the fault
        that ended it.
        """
        if not self._motion_lock.acquire(blocking=False):
            raise MotionRefused(f"{self._name}: another motion is running")
        try:
            return self._execute(plan, stop_count, timeout_s)
        finally:
            self._motion_lock.release()

    def await_end(self, timeout_s: float) -> None:
        """Wait until another thread has noticed that its motion was stopped."""
        if self._motion_lock.acquire(timeout=max(0.0, timeout_s)):
            self._motion_lock.release()

    def wait(self, condition: Condition, timeout_s: float) -> LinkState | None:
        """Wait as `LinkClient.wait` does, and latch a fault if the real-time process ends."""
        try:
            return self._connections.link.wait(condition, timeout_s)
        except LinkProcessDied as error:
            self._watch.latch(error)
            raise

    def _execute(self, plan: MotionPlan, stop_count: int, timeout_s: float) -> LinkState:
        link = self._connections.link
        number = link.command(CommandKind.MOVE, plan, stop_count)
        start = link.state
        rested_cycles: int | None = None  # when the path was first seen to have ended

        def has_ended(state: LinkState) -> bool:
            if state.fault:
                return not state.moving
            return state.command_number >= number and state.result is not Result.RUNNING

        while (state := self.wait(has_ended, POLL_S)) is None:
            self._watch.check()
            if link.stalled_s > POLL_S:
                self._watch.raise_any()
            # The controller's cycles are theatre time; if none arrive, the silence limit trips.
            state = link.state
            if state.moving or state.command_number < number or state.result is not Result.RUNNING:
                rested_cycles = None
            elif rested_cycles is None:  # the next check is a while later also where theatre time runs fast
                rested_cycles = state.cycles
            elif (state.cycles - rested_cycles) * self._cycle_s > SETTLE_LIMIT_S:
                raise MotionNotFinished(
                    f"{self._name}: the arm did not settle at the end of its path{losses_text(start, state)}",
                    limit=f"{SETTLE_LIMIT_S:g} s",
                    got=furthest_text(state),
                )
            waited_s = (state.cycles - start.cycles) * self._cycle_s
            if waited_s > timeout_s:
                link.stop(StopOrder.HOLD)
                self.wait(lambda s: not s.moving, STOP_S)
                raise MotionNotFinished(
                    f"{self._name}: the motion did not end or settle{losses_text(start, link.state)}",
                    limit=f"{timeout_s:g} s",
                    got=axes_text(link.state),
                )
        self._watch.raise_any()
        if state.result is Result.STOPPED:
            raise MotionStopped(f"{self._name}: stopped before its end", got=axes_text(state))
        if state.result is not Result.DONE:
            raise refusal_error(self._name, state)
        return state
