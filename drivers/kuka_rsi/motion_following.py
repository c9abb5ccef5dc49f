"""Passes one motion to the real-time process and follows it to its end."""

from __future__ import annotations

import threading

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.errors import LinkProcessDied, MotionNotFinished, MotionRefused, MotionStopped
from drivers.kuka_rsi.fault_errors import axes_text, error_of_refusal, furthest_text, losses_text
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.link_client import Condition
from drivers.kuka_rsi.realtime.link_state import CommandKind, LinkState, Result, StopOrder
from ronna_hw.arm.motion.planning import MotionPlan

POLL_S = 0.5  # host time between checks of theatre time during a motion
SETTLE_LIMIT_S = 5.0  # theatre time at the end of the path; servos settle within a tenth of a second
STOP_S = 1.0  # host time for a motion that has used up its time to come to rest


class MotionFollower:
    """One motion at a time."""

    def __init__(self, name: str, connections: Connections, watch: FaultWatch, cycle_s: float) -> None:
        self._name = name
        self._connections = connections
        self._watch = watch
        self._cycle_s = cycle_s
        self._under_way = threading.Lock()  # held while a motion is followed

    def follow(self, plan: MotionPlan, stops: int, timeout_s: float) -> LinkState:
        """Execute a plan made when `stops` stops were known; returns the state once it has settled.

        Raises RSI-010 when it was stopped, also before it began, RSI-011 when it used up `timeout_s` of
        controller cycles or did not settle at the end of its path, RSI-012 when it was refused, and the fault
        that ended it.
        """
        if not self._under_way.acquire(blocking=False):
            raise MotionRefused(f"{self._name}: another motion is running")
        try:
            return self._carry_out(plan, stops, timeout_s)
        finally:
            self._under_way.release()

    def await_end(self, timeout_s: float) -> None:
        """Let another thread notice that its motion was stopped, before the link ends."""
        if self._under_way.acquire(timeout=max(0.0, timeout_s)):
            self._under_way.release()

    def wait(self, condition: Condition, timeout_s: float) -> LinkState | None:
        """Like `LinkClient.wait`; also latches the death of the real-time process."""
        try:
            return self._connections.link.wait(condition, timeout_s)
        except LinkProcessDied as error:
            self._watch.latch(error)
            raise

    def _carry_out(self, plan: MotionPlan, stops: int, timeout_s: float) -> LinkState:
        link = self._connections.link
        number = link.command(CommandKind.MOVE, plan, stops)
        begun = link.state
        rested_cycles: int | None = None  # when the path was first seen to have ended

        def ended(state: LinkState) -> bool:
            if state.fault:
                return not state.moving
            return state.command_number >= number and state.result is not Result.RUNNING

        while (state := self.wait(ended, POLL_S)) is None:
            self._watch.notice()
            if link.stalled_s > POLL_S:
                self._watch.raise_any()
            # The controller's cycles are theatre time; if none arrive, the silence limit trips.
            state = link.state
            if state.moving or state.command_number < number or state.result is not Result.RUNNING:
                rested_cycles = None
            elif rested_cycles is None:  # the next look is a while later also where theatre time runs fast
                rested_cycles = state.cycles
            elif (state.cycles - rested_cycles) * self._cycle_s > SETTLE_LIMIT_S:
                raise MotionNotFinished(
                    f"{self._name}: the arm did not settle at the end of its path{losses_text(begun, state)}",
                    limit=f"{SETTLE_LIMIT_S:g} s",
                    got=furthest_text(state),
                )
            waited_s = (state.cycles - begun.cycles) * self._cycle_s
            if waited_s > timeout_s:
                link.stop(StopOrder.HOLD)
                self.wait(lambda s: not s.moving, STOP_S)
                raise MotionNotFinished(
                    f"{self._name}: the motion did not end or settle{losses_text(begun, link.state)}",
                    limit=f"{timeout_s:g} s",
                    got=axes_text(link.state),
                )
        self._watch.raise_any()
        if state.result is Result.STOPPED:
            raise MotionStopped(f"{self._name}: stopped before its end", got=axes_text(state))
        if state.result is not Result.DONE:
            raise error_of_refusal(self._name, state)
        return state
