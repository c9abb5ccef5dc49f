"""Power, safety state and remote control of a Universal Robots arm, over its dashboard."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from drivers.universal_robots.dashboard import DashboardClient, is_accepted
from drivers.universal_robots.errors import LOCAL_MODE, NOT_POWERED, PROTECTIVELY_STOPPED, SAFETY_STOPPED
from drivers.universal_robots.generations import GENERATIONS
from drivers.universal_robots.safety import NORMAL_MODES, RESTART_MODES, SAFETY_REFUSALS, safety_text
from ronna_hw.arm_stream.connections import remaining_s
from ronna_hw.arm_stream.errors import MalformedMessage, NoAnswer
from ronna_hw.clock import Clock, passing
from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.wire.universal_robots import RobotMode, SafetyMode
from ronna_hw.wire.universal_robots_services import DashboardOrder, Query

POLL_S = 0.05  # host time between two looks at the controller's modes
PASSING_SHARE = 10.0  # of theatre time that may pass meanwhile, where it runs freely
POWER_LIMIT_S = 30.0  # host time for power and brakes (U: 5 s each and more)
UNLOCK_PAUSE_S = 0.25
ASK_LIMIT_S = 1.0


class PowerAndSafety:
    """Switching an arm on and off, and releasing its stops; nothing here moves it."""

    def __init__(self, name: str, model: str, clock: Clock, dashboard: Callable[[], DashboardClient]) -> None:
        """`dashboard` returns the open connection, or raises URD-002."""
        self._name, self._model, self._clock, self._dashboard = name, model, clock, dashboard
        self._goes_off = False  # on our order, until the robot mode says so

    def is_remote(self, timeout_s: float) -> bool | None:
        """Return whether the controller is in remote control; None for CB3, which has no such mode."""
        has_one = GENERATIONS[self._model].has_remote_control
        return self._dashboard().is_remote(timeout_s) if has_one else None

    def acknowledge(self, person: str, deadline: float) -> None:
        """End any program and release what a person has to release; moves nothing.

        Raises URD-006, URD-007, URD-009 or URD-010 for what remains.
        """
        dashboard = self._dashboard()
        self.require_remote()
        dashboard.require(DashboardOrder.STOP, ASK_LIMIT_S)
        if self._goes_off:
            self.await_condition(lambda: dashboard.robot_mode(ASK_LIMIT_S) is RobotMode.POWER_OFF, deadline)
            self._goes_off = False  # a person has looked, even if it has been switched on again meanwhile
        if (safety := dashboard.safety_mode(ASK_LIMIT_S)) is SafetyMode.PROTECTIVE_STOP:
            self._unlock(person, deadline)
        elif safety in RESTART_MODES:
            dashboard.ask(DashboardOrder.CLOSE_SAFETY_POPUP, ASK_LIMIT_S)
            dashboard.require(DashboardOrder.RESTART_SAFETY, ASK_LIMIT_S)
        if safety in (SafetyMode.PROTECTIVE_STOP, *RESTART_MODES):
            self.await_condition(lambda: dashboard.safety_mode(ASK_LIMIT_S) in NORMAL_MODES, deadline)
        self.require_safe()

    def switch_off(self, timeout_s: float) -> None:
        """Switch the arm off; until it is off, no start succeeds."""
        self._goes_off = True
        self._dashboard().require(DashboardOrder.POWER_OFF, timeout_s)

    def switch_on(self) -> None:
        """Switch power on and release the brakes; raises URD-008 if that takes too long."""
        dashboard, deadline = self._dashboard(), time.monotonic() + POWER_LIMIT_S
        mode = dashboard.robot_mode(ASK_LIMIT_S)
        self._goes_off = self._goes_off and mode is not RobotMode.POWER_OFF
        self.require_not_switching_off()
        if mode is RobotMode.RUNNING:
            return
        if mode not in (RobotMode.IDLE, RobotMode.BACKDRIVE):
            dashboard.require(DashboardOrder.POWER_ON, ASK_LIMIT_S)
            self._await_mode((RobotMode.IDLE, RobotMode.RUNNING), deadline)
        dashboard.require(DashboardOrder.BRAKE_RELEASE, ASK_LIMIT_S)
        self._await_mode((RobotMode.RUNNING,), deadline)

    def require_not_switching_off(self) -> None:
        """Raise URD-008 while the arm is being switched off on our own order."""
        if self._goes_off:
            raise NOT_POWERED(
                f"{self._name}: the arm is being switched off on request",
                expected=RobotMode.POWER_OFF.name,
                got=self._dashboard().robot_mode(ASK_LIMIT_S).name,
                action=f"Wait until it is off, then {ACKNOWLEDGE}: the next start switches it on again.",
            )

    def require_remote(self) -> None:
        """Raise URD-006 while the pendant has the control."""
        if self.is_remote(ASK_LIMIT_S) is False:
            raise LOCAL_MODE(f"{self._name}: the controller is in local control", expected="remote control")

    def require_safe(self) -> None:
        """Raise what the safety state reports, unless it permits motion."""
        if (mode := self._dashboard().safety_mode(ASK_LIMIT_S)) not in NORMAL_MODES:
            raise SAFETY_REFUSALS.get(mode, SAFETY_STOPPED)(f"{self._name}: {safety_text(mode)}")

    def await_condition(self, holds: Callable[[], bool], deadline: float) -> bool:
        """Poll until a condition holds or a host time; returns whether it holds."""
        while not holds():
            if remaining_s(deadline) <= 0.0:
                return False
            self._pause(POLL_S)
        return True

    def _await_mode(self, modes: tuple[RobotMode, ...], deadline: float) -> None:
        if not self.await_condition(lambda: self._dashboard().robot_mode(ASK_LIMIT_S) in modes, deadline):
            raise NOT_POWERED(
                f"{self._name}: the arm was not switched on",
                expected=RobotMode.RUNNING.name,
                limit=f"{POWER_LIMIT_S:g} s",
                got=self._dashboard().robot_mode(ASK_LIMIT_S).name,
            )

    def _unlock(self, person: str, deadline: float) -> None:
        """Release a protective stop in the name of a person, as soon as the controller permits it."""
        dashboard = self._dashboard()
        with contextlib.suppress(NoAnswer, MalformedMessage):  # an entry in the log is no condition
            name = person.encode("ascii", "replace").decode()
            dashboard.ask(Query.ADD_TO_LOG, ASK_LIMIT_S, f"protective stop released by {name}")
        dashboard.ask(DashboardOrder.CLOSE_SAFETY_POPUP, ASK_LIMIT_S)
        while True:
            answer = dashboard.ask(DashboardOrder.UNLOCK_PROTECTIVE_STOP, ASK_LIMIT_S)
            if is_accepted(DashboardOrder.UNLOCK_PROTECTIVE_STOP, answer):
                return
            if remaining_s(deadline) <= UNLOCK_PAUSE_S:
                raise PROTECTIVELY_STOPPED(f"{self._name}: the protective stop remains", got=answer)
            self._pause(UNLOCK_PAUSE_S)

    def _pause(self, host_s: float) -> None:
        """Wait, and let theatre time pass: the controller may need it."""
        with passing(self._clock, PASSING_SHARE * host_s):
            time.sleep(host_s)
