"""Fault detection for the real-time process and the controller's other interfaces.

Safety, power and program are watched by the real-time process in every cycle. From here the arm is stopped
when the primary interface breaks or falls silent, as when the pendant is switched to local control. A program
that the controller has only paused is ended: resumed, it would follow set-points of another moment. So is one
that has taken the place of ours.
"""

from __future__ import annotations

import contextlib
import threading
import time

from drivers.universal_robots.connections import Connections
from drivers.universal_robots.errors import LINK_BROKEN, PROGRAM_STOPPED, STREAM_ERRORS, SWITCHED_TO_LOCAL
from drivers.universal_robots.faults import may_be_power
from drivers.universal_robots.primary.client import ControllerState
from ronna_hw.arm_stream.records import LinkFault, StopOrder, StreamPhase
from ronna_hw.arm_stream.watch import StreamWatch
from ronna_hw.devices.lifecycle import RUNNING, LifecycleGuard
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError, is_error

DASHBOARD_LIMIT_S = 1.0
EXPLAIN_LIMIT_S = 2.0 * DASHBOARD_LIMIT_S  # another question may have to be answered before
POWER_DOWN_S = 1.0  # host time from the stop of a program to the robot mode of power going off (U)
# A switch to local control can look like each of these.
MAY_BE_CONTROL = (STREAM_ERRORS.lost, LINK_BROKEN, PROGRAM_STOPPED)
LINK_FAULTS = (LinkFault.SILENCE, LinkFault.BROKEN, LinkFault.RESTARTED)


class UrWatch(StreamWatch[ControllerState]):
    """Fault monitor for one arm, and listener on its primary interface."""

    mode: OperatingMode
    _connections: Connections

    def __init__(self, guard: LifecycleGuard, connections: Connections) -> None:
        super().__init__(guard, connections, OperatingMode.AUTOMATIC)
        self._program_ended = False  # since the last fault
        self._explaining = threading.Condition()
        self._explained: RonnaError | None = None  # loss of the primary interface whose cause is known
        self._certain_s: float | None = None  # host time at which a stopped program has no further cause

    def check_until_certain(self) -> None:
        """Latch any fault as `check` does, but wait for the cause that ended program or connection."""
        with self._explaining:
            self._explaining.wait_for(lambda: not self._awaits_explanation(), EXPLAIN_LIMIT_S)
        self.check()
        link, certain_s = self._connections.open_link, self._certain_s
        if link is None or certain_s is None or self._guard.state not in RUNNING:
            return
        with contextlib.suppress(RonnaError):  # of a process that ends: that is latched
            link.wait(lambda state: not may_be_power(state), max(0.0, certain_s - time.monotonic()))
        self._certain_s = 0.0
        self.check()

    def _awaits_cause(self) -> bool:
        """Return whether the primary interface is lost, or our program has stopped just now.

        Its reader then asks why. When power goes off, the robot mode tells later: the arm is at rest, or
        being stopped by the controller; nothing is sent any more.
        """
        if self._awaits_explanation():
            return True
        link = self._connections.open_link
        if link is None or self._guard.state not in RUNNING or not (link.alive and may_be_power(link.state)):
            self._certain_s = None
            return False
        now_s = time.monotonic()
        if self._certain_s is None:
            self._certain_s = now_s + POWER_DOWN_S
        return now_s < self._certain_s

    def on_state(self, state: ControllerState) -> None:
        """Check a state of the primary interface; called on its reader thread."""
        self._end_program()  # first: another one may be driving the arm
        super().on_state(state)

    def on_silence(self) -> None:
        """Check whether the controller has been silent for too long; called on the reader thread."""
        self._end_program()
        super().on_silence()

    def on_loss(self, failure: RonnaError) -> None:
        """Stop the arm after losing the primary interface, and find out whether the control was switched.

        Other threads wait for that: `failure` can be seen before this is called.
        """
        try:
            if self._guard.state in RUNNING and (link := self._connections.open_link) is not None:
                link.stop(StopOrder.PROTECTIVE)  # first: to ask takes up to a second
                self._latch_with_record(self._cause_of(failure), link)
        finally:
            with self._explaining:
                self._explained = failure
                self._explaining.notify_all()

    def _awaits_explanation(self) -> bool:
        """Return whether the primary interface is lost, and its reader about to ask why."""
        control = self._connections.open_control
        failure = None if control is None else control.failure
        return failure is not None and failure is not self._explained and self._guard.state in RUNNING

    def _cause_of(self, error: RonnaError) -> RonnaError:
        """Return that the control was switched, if so: that closes connections, and may end our program."""
        if is_error(error, *MAY_BE_CONTROL):
            with contextlib.suppress(RonnaError):
                if self._connections.power.is_remote(DASHBOARD_LIMIT_S) is False:
                    return SWITCHED_TO_LOCAL(
                        f"{self._connections.faults.name}: the pendant was switched to local control",
                        expected="remote control",
                    )
        return error

    def _end_program(self) -> None:
        """End whatever program runs, once after a fault for which nothing is sent any more."""
        link, dashboard = self._connections.open_link, self._connections.open_dashboard
        if link is None or dashboard is None:
            return
        state = link.state
        must_end = state.phase is StreamPhase.SILENT or state.fault in LINK_FAULTS
        if must_end and not self._program_ended:
            try:
                self._connections.stop_program(DASHBOARD_LIMIT_S)
            except RonnaError:
                return  # at the next state, or the next silence, again
        self._program_ended = must_end
