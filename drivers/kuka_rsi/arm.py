"""KUKA KR C4 arm as a `RobotArm`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable
from dataclasses import replace

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.client import ControllerCommands
from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import STREAM_ERRORS, UNVERIFIED_CONTROLLER
from drivers.kuka_rsi.fault_errors import RsiFaults
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.micro_move import MicroMove
from drivers.kuka_rsi.options import ROLES, load_usable_context, read_options
from drivers.kuka_rsi.readiness import controller_facts, readiness_facts
from drivers.theatre_options import naming_endpoints_too
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm_stream.arm import CLOSING_STOP_S, StreamedArm
from ronna_hw.arm_stream.load_sums import LoadMeans
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.lifecycle import Lifecycle, LifecycleGuard, require_person
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import CommandName, OperationMode

UNVERIFIED = (
    "the controller does not report which program it runs: to verify it, each axis in turn moves out and "
    "back by less than 0.05 mm at the flange, with a person next to the arm"
)
IN_T1 = "the controller is in T1: someone holding the pendant is next to the arm"


class KukaRsiArm(StreamedArm[ControllerState]):
    """Arm driven through the endpoints `rsi` (udp://, our receiving address) and `eki_project` (tcp://).

    `connect` raises EKI-001 when nothing answers, EKI-005 or EKI-006 for a different controller or set-up;
    `configure` RSI-001.
    """

    wire_protocol = "kuka-rsi-eki"
    connections: Connections
    _watch: FaultWatch

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the configuration without connecting; raises CFG-001, CFG-002, RSI-013 or RSI-017."""
        with naming_endpoints_too(name, config, ROLES):
            options = read_options(name, config.options)
        context = load_usable_context(name, options)
        arm, guard = kr6_r900(options.variant), LifecycleGuard(name)
        faults = RsiFaults(name, arm, STREAM_ERRORS, options)
        connections = Connections(faults, config, context, clock)
        limits = options.limits(arm, context.program.cycle_ms / 1000.0)
        self.senses_force, self.force_error_N = options.force_sensor, options.force_error_N
        super().__init__(guard, connections, FaultWatch(guard, connections), limits)
        self._t1_confirmed_by = ""
        self._prompted: tuple[str, ...] = ()  # the texts last returned by `to_confirm`
        self._micro_move_confirmed_by = ""

    @property
    def controller(self) -> ControllerCommands:
        """Controller commands for tool, base and override, and access to the controller state."""
        return ControllerCommands(self._guard, lambda: self.connections.control)

    @property
    def to_confirm(self) -> str | None:
        reported_state = self.connections.reported
        prompts = []
        if self.connections.open_control is not None and not self.connections.verified:
            prompts.append(UNVERIFIED)
        if reported_state is not None and reported_state.mode is OperationMode.T1:
            prompts.append(IN_T1)
        self._prompted = tuple(prompts)
        return "; ".join(prompts) or None

    def confirm_start(self, confirmed_by: str) -> None:
        person = require_person(confirmed_by)
        self._micro_move_confirmed_by = person if UNVERIFIED in self._prompted else ""
        self._t1_confirmed_by = person if IN_T1 in self._prompted else ""

    def readiness(self, timeout_s: float = 1.0) -> tuple[Fact, ...]:
        """Report every condition that `activate` checks, with the controller's current values."""
        return tuple(readiness_facts(self._request_state(timeout_s), verified=self.connections.verified))

    def allow_t1(self, confirmed_by: str) -> None:
        """Allow the next `activate` to start in T1, with a person at the arm holding the pendant.

        Motions then stay within reduced speed and a tenth of the axes' full speed.
        """
        self._t1_confirmed_by = require_person(confirmed_by)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start the RSI program and its stream; returns once corrections take effect.

        Raises EKI-006 when the controller does not report which context it runs (see `confirm_start`),
        EKI-007 when it is not ready, EKI-008 when it refuses, RSI-002 when no telegram comes, RSI-015 when
        RSI and EKI disagree about the axes. Errors after the start are latched; `recover` clears them. A stop
        during the start leaves the arm in HOLD.
        """
        self._guard.require("activate", (Lifecycle.CONFIGURED,))
        person, self._micro_move_confirmed_by = self._micro_move_confirmed_by, ""
        if self.connections.verified:
            super().activate(timeout_s)
        elif person:
            self.activate_unverified(person, timeout_s)
        else:
            raise UNVERIFIED_CONTROLLER(f"{self._name}: the controller does not report which context it runs")

    def activate_unverified(self, confirmed_by: str, timeout_s: float = 30.0) -> None:
        """Activate with a controller whose context is unknown, after testing its response by a micro-move.

        Each axis in turn moves out and back by less than 0.05 mm at the flange, once someone next to the arm
        has confirmed. Raises, latched, RSI-018 when an axis does anything else, RSI-010 when it is stopped,
        RSI-007 when the real-time process ends.
        """
        self._guard.require("activate_unverified", (Lifecycle.CONFIGURED,))
        require_person(confirmed_by)
        link = self.connections.link
        stop_count = link.stop_number
        self._start(timeout_s)
        try:
            limits = self.limits(_operating_mode(self._watch.mode))
            MicroMove(self._name, link, self.kinematics, limits, stop_count).verify()
        except RonnaError as error:
            self._watch.latch(error)
            with contextlib.suppress(RonnaError):
                self.connections.end_stream(time.monotonic() + CLOSING_STOP_S)
            raise
        self._enter_active(stop_count, mode=self._watch.mode)

    def _start_stream(self, timeout_s: float) -> None:
        t1_allowed, self._t1_confirmed_by = bool(self._t1_confirmed_by), ""
        modes = (OperationMode.EXT, OperationMode.T1) if t1_allowed else (OperationMode.EXT,)
        limits = {mode: self.limits(_operating_mode(mode)) for mode in modes}
        self._watch.mode = self.connections.start_stream(timeout_s, limits)

    def _stream_mode(self) -> OperatingMode:
        return _operating_mode(self._watch.mode)

    def _reported_mode(self, state: ControllerState) -> OperatingMode:
        return _operating_mode(state.mode)

    def _tool_number(self, state: ControllerState) -> int:
        return state.tool

    def _name_loads(self, loads: AxisLoads, means: LoadMeans) -> AxisLoads:
        return replace(loads, current_percent=means.currents)

    def _controller_facts(self, state: ControllerState) -> Iterable[Fact]:
        return controller_facts(state)

    def _is_to_acknowledge(self, timeout_s: float) -> bool:
        return bool(self._request_state(timeout_s).error)

    def _switch_drives_off(self, timeout_s: float) -> None:
        self.connections.control.require(CommandName.DRIVES, timeout_s, On=0)


def _operating_mode(mode: OperationMode) -> OperatingMode:
    """Convert a KUKA mode to the vendor-neutral operating mode; streams start only in EXT or T1."""
    return OperatingMode.REDUCED_SPEED if mode is OperationMode.T1 else OperatingMode.AUTOMATIC
