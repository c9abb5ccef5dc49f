"""Motion planning within limits and clear of obstacles, and supervision of execution."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm_stream.client import Condition
from ronna_hw.arm_stream.connections import StreamConnections
from ronna_hw.arm_stream.control_channel import S
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.guided import GuideLimits
from ronna_hw.arm_stream.records import (
    NO_LIMIT,
    ForceLimit,
    GuideByHand,
    LinkState,
    MotionResult,
    Move,
    StopOrder,
)
from ronna_hw.arm_stream.watch import StreamWatch
from ronna_hw.devices.contact import GuidanceEnd
from ronna_hw.devices.robot import Motion, OperatingMode
from ronna_hw.errors import DeviceError, LinkTimeout, is_error
from ronna_hw.logs import logger
from ronna_hw.preview import plan_motion, preview_motion, with_speed_steps
from ronna_hw.vectors import JointVector

POLL_S = 0.5  # host time between checks of theatre time during a motion
# Safety against an arm that does not come to rest at the end of its path (U).
SETTLE_LIMIT_S = 5.0  # theatre time at the end of the path; servos settle within a tenth of a second

HELD_POLL_S = 0.02  # host time between looks at an enabling switch
STOP_S = 1.0  # for an arm that must stop: host time at the motion's time limit, theatre time after a fault


class MotionPlanner:
    """Motion planner of one arm; `kinematics` and `surroundings` may be replaced between motions."""

    def __init__(self, name: str, kinematics: Kinematics, limits: MotionLimits) -> None:
        """Plan with these limits of automatic operation."""
        self._name = name
        self.kinematics = kinematics
        self._limits = limits
        self.surroundings = Surroundings()

    def limits(self, mode: OperatingMode) -> MotionLimits:
        """Return the motion limits for an operating mode."""
        if mode is OperatingMode.REDUCED_SPEED:
            return self._limits.with_reduced_speed(self.kinematics)
        return self._limits

    def plan(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> MotionPlan:
        """Plan a motion from `start_rad`; raises the errors of `plan_motion`."""
        return plan_motion(self.kinematics, start_rad, motion, self.limits(mode))

    def clear_plan(self, plan: MotionPlan, mode: OperatingMode) -> MotionPlan:
        """Add speed limits along the path to a plan; raises ARM-007 if clearance is violated."""
        path = sweep_path(self.kinematics, plan, self.surroundings)
        path.require(f"the path of {self._name}")
        return with_speed_steps(plan, path, self.limits(mode).body_speed_mm_s)

    def preview(self, motion: Motion, start_rad: JointVector, mode: OperatingMode) -> PathPreview:
        """Plan a motion and preview its path; raises the errors of `plan`."""
        return preview_motion(self.kinematics, start_rad, motion, self.surroundings, self.limits(mode))


class MotionFollower(Generic[S]):
    """Executor that supervises one motion at a time, until the arm has settled if it is to."""

    def __init__(self, connections: StreamConnections[S, Any], watch: StreamWatch[S], cycle_s: float) -> None:
        self._connections = connections
        self._watch = watch
        self._cycle_s = cycle_s
        self._log = logger(device=connections.faults.name)
        self._motion_lock = threading.Lock()  # held while a motion is followed

    @property
    def _faults(self) -> StreamFaults:
        """Errors and words of the arm, as it is known by now."""
        return self._connections.faults

    def follow(
        self,
        plan: MotionPlan,
        stop_count: int,
        timeout_s: float,
        force: ForceLimit = NO_LIMIT,
        *,
        settles: bool = True,
    ) -> LinkState:
        """Execute a plan and return the final state; more than `stop_count` stops prevent or stop it.

        Unless it `settles`, it ends with its last set-point.

        Raises the driver's errors: stopped, also before it began; not finished, when it used up `timeout_s`
        of controller cycles or did not settle at the end of its path; refused; and the fault that ended it.
        Raises ARM-014 and ARM-015 for a force limit.
        """
        if not self._motion_lock.acquire(blocking=False):
            raise self._faults.errors.refused(f"{self._faults.name}: another motion is running")
        try:
            return self._execute(Move(plan, force, settles), stop_count, timeout_s)
        finally:
            self._motion_lock.release()

    def follow_hand(
        self, guide: GuideLimits, force_limit_N: float, stop_count: int, is_held: Callable[[], bool]
    ) -> tuple[LinkState, GuidanceEnd]:
        """Follow a hand while `is_held`; raises like `follow`. Any exception of `is_held` stops the arm."""
        if not self._motion_lock.acquire(blocking=False):
            raise self._faults.errors.refused(f"{self._faults.name}: another motion is running")
        link = self._connections.link
        try:
            number = link.command(GuideByHand(guide, force_limit_N), stop_count)
            begin = link.state.cycles
            is_released = False
            while (state := self.wait(_has_ended(number), HELD_POLL_S)) is None:
                self._watch.check()
                if link.stalled_s > POLL_S:
                    self._watch.raise_any()
                if not is_released and not is_held():
                    is_released = True
                    stop_count = link.stop(StopOrder.HOLD)
            self._watch.raise_any()
            if state.result is MotionResult.FORCE:
                raise self._faults.force_error(state, ForceLimit(force_limit_N))
            if state.result is not MotionResult.STOPPED:
                raise self._faults.refusal_error(state)
            if link.stop_number != stop_count:
                raise self._faults.errors.stopped(
                    f"{self._faults.name}: stopped while it followed a hand",
                    got=self._faults.axes_text(state),
                )
            if is_released:
                return state, GuidanceEnd.RELEASED
            is_over = state.cycles - begin >= guide.cycles
            return state, GuidanceEnd.TIMED_OUT if is_over else GuidanceEnd.AT_LIMIT
        except BaseException:  # including interruptions: the arm does not go on without its caller
            link.stop(StopOrder.HOLD)
            raise
        finally:
            self._motion_lock.release()

    def await_end(self, timeout_s: float) -> None:
        """Wait until another thread has noticed that its motion was stopped."""
        if self._motion_lock.acquire(timeout=max(0.0, timeout_s)):
            self._motion_lock.release()

    def not_at_rest_error(self, timeout_s: float) -> LinkTimeout:
        """Build the error for an arm that a stop does not bring to rest in time."""
        return self._faults.errors.not_finished(
            f"{self._faults.name}: the arm does not come to rest", limit=f"{timeout_s:g} s"
        )

    def wait(self, condition: Condition, timeout_s: float) -> LinkState | None:
        """Wait as `LinkClient.wait` does, and latch a fault if the real-time process ends."""
        try:
            return self._connections.link.wait(condition, timeout_s)
        except DeviceError as error:
            if is_error(error, self._faults.errors.died):
                self._watch.latch(error)
            raise

    def _execute(self, move: Move, stop_count: int, timeout_s: float) -> LinkState:
        link = self._connections.link
        number = link.command(move, stop_count)
        start = link.state
        rested_cycles: int | None = None  # when the path was first seen to have ended
        faulted_cycles: int | None = None  # when a fault was first seen
        is_told = False  # that it waits
        has_ended = _has_ended(number)
        while (state := self.wait(has_ended, POLL_S)) is None:
            self._watch.check()
            if link.stalled_s > POLL_S:
                self._watch.raise_any()
            if not is_told and link.state.speed_share == 0.0:
                is_told = True
                self._log.warning("the motion waits", because=f"{self._faults.errors.words.speed} is at 0%")
            # The controller's cycles are theatre time; if none arrive, the silence limit trips.
            state = link.state
            if state.fault and faulted_cycles is None:
                faulted_cycles = state.cycles
            if faulted_cycles is not None and (state.cycles - faulted_cycles) * self._cycle_s > STOP_S:
                break  # the fault is news, whether the arm has come to rest or not
            if state.moving or state.command_number < number or state.result is not MotionResult.RUNNING:
                rested_cycles = None
            elif rested_cycles is None:  # the next check is a while later also where theatre time runs fast
                rested_cycles = state.cycles
            elif (state.cycles - rested_cycles) * self._cycle_s > SETTLE_LIMIT_S:
                self._watch.raise_any()
                losses = self._faults.losses_text(start, state)
                raise self._faults.errors.not_finished(
                    f"{self._faults.name}: the arm did not settle at the end of its path{losses}",
                    limit=f"{SETTLE_LIMIT_S:g} s",
                    got=self._faults.furthest_text(state),
                )
            if (state.cycles - start.cycles) * self._cycle_s > timeout_s:
                link.stop(StopOrder.HOLD)
                self.wait(lambda s: not s.moving, STOP_S)
                self._watch.raise_any()
                raise self._faults.not_finished_error(start, link.state, timeout_s)
        self._watch.raise_any()
        if state.result.is_by_force:
            raise self._faults.force_error(state, move.force)
        if state.result is MotionResult.STOPPED:
            raise self._faults.errors.stopped(
                f"{self._faults.name}: stopped before its end", got=self._faults.axes_text(state)
            )
        if state.result not in (MotionResult.DONE, MotionResult.THROUGH, MotionResult.BONELESS):
            raise self._faults.refusal_error(state)
        return state


def _has_ended(number: int) -> Condition:
    """Return the condition that the motion of a command has ended."""

    def has_ended(state: LinkState) -> bool:
        if state.fault:
            return not state.moving
        return state.command_number >= number and state.result is not MotionResult.RUNNING

    return has_ended
