"""KUKA KR C4 arm as a `RobotArm`."""

from __future__ import annotations

import contextlib
import time

from drivers.kuka_rsi.connections import Connections, remaining_s
from drivers.kuka_rsi.eki.client import ControllerCommands
from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import Unverified
from drivers.kuka_rsi.fault_errors import stream_faults
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.micro_move import MicroMove
from drivers.kuka_rsi.options import load_usable_context, planning_limits, read_options
from drivers.kuka_rsi.readings import ArmReadings, controller_facts, readiness_facts
from ronna_hw.arm.kr6_r900 import Kr6R900, kr6_r900
from ronna_hw.arm_stream.arm import CLOSING_STOP_S, StreamedArm
from ronna_hw.arm_stream.motion import MotionFollower, MotionPlanner
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, Fact
from ronna_hw.devices.lifecycle import (
    READABLE,
    RUNNING,
    Identity,
    LastKnown,
    Lifecycle,
    LifecycleGuard,
    require_person,
)
from ronna_hw.devices.readings import ArmReading, ToolIdentity
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import CommandName, OperationMode

EKI_REPLY_LIMIT_S = 0.5  # host time: a connection silent for longer is reopened in a recovery
LIVE_HEARTBEAT_S = 0.2  # largest age of the real-time process' last heartbeat for it to be worth contacting
UNVERIFIED = (
    "the controller does not report which program it runs: to verify it, each axis in turn moves out and "
    "back by less than 0.05 mm at the flange, with a person next to the arm"
)
IN_T1 = "the controller is in T1: someone holding the pendant is next to the arm"


class KukaRsiArm(StreamedArm):
    """Arm driven through the endpoints `rsi` (udp://, our receiving address) and `eki_project` (tcp://)."""

    wire_protocol = "kuka-rsi-eki"
    _kinematics: Kr6R900
    _readings: ArmReadings

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the configuration without connecting; raises CFG-001, CFG-002, RSI-013 or RSI-017."""
        self._name = name
        self._clock = clock
        self._options = options = read_options(name, config.options)
        context = load_usable_context(name, options)
        self._kinematics = kr6_r900(options.variant)
        cycle_s = context.program.cycle_ms / 1000.0
        self._planner = MotionPlanner(name, self._kinematics, planning_limits(options, cycle_s))
        self._guard = LifecycleGuard(name)
        self._streams = self.connections = Connections(name, config, options, context, clock)
        self._watching = self._watch = FaultWatch(name, self._guard, self.connections, options)
        self._follower = MotionFollower(stream_faults(name, options), self.connections, self._watch, cycle_s)
        self._readings = ArmReadings(self.connections, clock, options.silence_limit_s)
        self._t1_confirmed_by = ""
        self._prompted: tuple[str, ...] = ()  # the texts last returned by `to_confirm`
        self._micro_move_confirmed_by = ""

    @property
    def kinematics(self) -> Kr6R900:
        return self._kinematics

    @property
    def operating_mode(self) -> OperatingMode:
        reported_state = None if self._guard.state in RUNNING else self.connections.reported
        return _operating_mode(self._watch.mode if reported_state is None else reported_state.mode)

    def observe(self) -> LastKnown[ArmReading]:
        streaming = self._guard.state in RUNNING  # unlike `state`, this does not check for new faults
        facts = tuple(controller_facts(self.connections.reported))
        return self._guard.last_known(self._readings.newest(streaming=streaming), facts)

    @property
    def controller(self) -> ControllerCommands:
        """Controller commands for tool, base and override, and access to the controller state."""
        return ControllerCommands(self._guard, lambda: self.connections.eki)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self.connections.recorder.sink = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open the EKI channel and check that the controller runs our RSI context for the configured arm.

        Raises EKI-001 when nothing answers, EKI-005 or EKI-006 for a different controller or set-up.
        """
        self._guard.require("connect", (Lifecycle.DISCONNECTED,))
        identity = self.connections.find_controller(timeout_s, self._watch)
        self._guard.enter(Lifecycle.CONNECTED, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Start the real-time process, which binds the RSI port; raises RSI-001."""
        self._guard.require("configure", (Lifecycle.CONNECTED,))
        self.connections.start_link(timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    @property
    def to_confirm(self) -> str | None:
        reported_state = self.connections.reported
        prompts = []
        if self.connections.open_eki is not None and not self.connections.verified:
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

        Motions then stay within 250 mm/s and a tenth of the axes' full speed.
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
        if not self.connections.verified:
            if person:
                self.activate_unverified(person, timeout_s)
                return
            raise Unverified(f"{self._name}: the controller does not report which context it runs")
        stop_count = self.connections.link.stop_number
        self._start(timeout_s)
        self._enter_active(stop_count, mode=self._watch.mode)

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
            MicroMove(self._name, link, self._kinematics, limits, stop_count).verify()
        except RonnaError as error:
            self._watch.latch(error)
            with contextlib.suppress(RonnaError):
                self.connections.end_stream(time.monotonic() + CLOSING_STOP_S)
            raise
        self._enter_active(stop_count, mode=self._watch.mode)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED: end the stream, acknowledge messages, check the controller.

        Moves nothing. A broken or silent EKI connection is reopened, with retries until the time limit. While
        CONNECTED a message of an earlier run is acknowledged, and the state stays CONNECTED. Raises what
        prevents it, such as EKI-007; a fault then stays latched.
        """
        self._watch.check()
        require_person(acknowledged_by)
        deadline = time.monotonic() + timeout_s
        connections = self.connections
        if self._guard.state is Lifecycle.CONNECTED and self._request_state(timeout_s).error:
            connections.acknowledge(deadline)
            return
        self._guard.require("recover", (Lifecycle.FAULT,))
        if not connections.is_eki_answering(EKI_REPLY_LIMIT_S):
            connections.find_controller(remaining_s(deadline), self._watch, retry=True)
        link = connections.open_link
        if link is not None:
            if link.alive and link.stalled_s < LIVE_HEARTBEAT_S:
                with contextlib.suppress(RonnaError):
                    connections.end_stream(time.monotonic() + 0.5 * remaining_s(deadline))
            connections.close_link()
        connections.acknowledge(deadline)
        connections.start_link(remaining_s(deadline))
        self._guard.enter(Lifecycle.CONFIGURED)

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Read the measured joint angles, from a running stream or otherwise by EKI."""
        self._watch.raise_new()
        self._guard.require("read_state", READABLE)
        if self._guard.state in RUNNING:
            return self._readings.from_stream(self.connections.link.state)
        return self._readings.from_controller(self._request_state(timeout_s))

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Read the tool number from the controller's inputs; 0 means no tool."""
        self._watch.raise_new()
        self._guard.require("read_tool_identity", READABLE)
        return ToolIdentity(self._readings.stamp(), self._request_state(timeout_s).tool)

    def _stream_mode(self) -> OperatingMode:
        return _operating_mode(self._watch.mode)

    def _switch_drives_off(self, timeout_s: float) -> None:
        self.connections.eki.require(CommandName.DRIVES, timeout_s, On=0)

    def _start(self, timeout_s: float) -> None:
        t1_allowed, self._t1_confirmed_by = bool(self._t1_confirmed_by), ""
        modes = (OperationMode.EXT, OperationMode.T1) if t1_allowed else (OperationMode.EXT,)
        limits = {mode: self.limits(_operating_mode(mode)) for mode in modes}
        try:
            self._watch.mode = self.connections.start_stream(timeout_s, limits)
        except RonnaError as error:
            self._watch.latch(error)
            raise

    def _request_state(self, timeout_s: float) -> ControllerState:
        try:
            return self.connections.eki.status(timeout_s)
        except RonnaError:
            self._watch.check()
            raise


def _operating_mode(mode: OperationMode) -> OperatingMode:
    """Convert a KUKA mode to the vendor-neutral operating mode; streams start only in EXT or T1."""
    return OperatingMode.REDUCED_SPEED if mode is OperationMode.T1 else OperatingMode.AUTOMATIC
