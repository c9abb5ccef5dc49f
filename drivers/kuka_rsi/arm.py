"""KUKA KR C4 arm as a `RobotArm`."""

from __future__ import annotations

import contextlib
import time
from contextlib import AbstractContextManager
from typing import Self

from drivers.kuka_rsi.connections import Connections, remaining_s
from drivers.kuka_rsi.eki.client import ControllerCommands
from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import MotionNotFinished, Unverified
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.micro_move import MicroMove
from drivers.kuka_rsi.motion import MotionFollower, MotionPlanner
from drivers.kuka_rsi.options import load_usable_context, read_options
from drivers.kuka_rsi.readings import ArmReadings, controller_facts, readiness_facts
from drivers.kuka_rsi.realtime.link_health import link_statistics
from drivers.kuka_rsi.realtime.link_state import NO_STATE, Phase, RecordedCycle, StopOrder
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.kr6_r900 import Kr6R900, kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.path_preview import PathPreview
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
    hold_active,
    require_person,
)
from ronna_hw.devices.readings import ArmReading, LinkStatistics, ToolIdentity
from ronna_hw.devices.robot import JointMove, LineMove, Motion, OperatingMode, StopKind
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_eki import CommandName, OperationMode

CLOSING_STOP_S = 1.0  # host time for the arm to come to rest in close()
EKI_REPLY_LIMIT_S = 0.5  # host time: a connection silent for longer is reopened in a recovery
LIVE_HEARTBEAT_S = 0.2  # largest age of the real-time process' last heartbeat for it to be worth contacting
UNVERIFIED = (
    "the controller does not report which program it runs: to verify it, each axis in turn moves out and "
    "back by less than 0.05 mm at the flange, with a person next to the arm"
)
IN_T1 = "the controller is in T1: someone holding the pendant is next to the arm"

_STOP_ORDERS = {
    StopKind.HOLD: StopOrder.HOLD,
    StopKind.PROTECTIVE: StopOrder.PROTECTIVE,
    StopKind.LINK: StopOrder.LINK,
    StopKind.DRIVES_OFF: StopOrder.DRIVES_OFF,
}


class KukaRsiArm:
    """Arm driven through the endpoints `rsi` (udp://, our receiving address) and `eki_project` (tcp://)."""

    wire_protocol = "kuka-rsi-eki"
    notices: tuple[str, ...] = ()

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the configuration without connecting; raises CFG-001, CFG-002, RSI-013 or RSI-017."""
        self._name = name
        self._clock = clock
        self._options = options = read_options(name, config.options)
        context = load_usable_context(name, options)
        self._kinematics = kr6_r900(options.variant)
        cycle_s = context.program.cycle_ms / 1000.0
        self._planner = MotionPlanner(name, self._kinematics, options, cycle_s)
        self._guard = LifecycleGuard(name)
        self.connections = Connections(name, config, options, context, clock)
        self._watch = FaultWatch(name, self._guard, self.connections, options)
        self._follower = MotionFollower(name, self.connections, self._watch, cycle_s)
        self._readings = ArmReadings(self.connections, clock, options.silence_limit_s)
        self._t1_confirmed_by = ""
        self._prompted: tuple[str, ...] = ()  # the texts last returned by `to_confirm`
        self._micro_move_confirmed_by = ""

    @property
    def name(self) -> str:
        return self._name

    @property
    def state(self) -> Lifecycle:
        self._watch.check_until_certain()
        return self._guard.state

    @property
    def kinematics(self) -> Kr6R900:
        return self._kinematics

    @property
    def operating_mode(self) -> OperatingMode:
        reported_state = None if self._guard.state in RUNNING else self.connections.reported
        return _operating_mode(self._watch.mode if reported_state is None else reported_state.mode)

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        return self._planner.limits(mode or self.operating_mode)

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, if any."""
        self._watch.check_until_certain()
        return self._guard.fault

    def observe(self) -> LastKnown[ArmReading]:
        streaming = self._guard.state in RUNNING  # unlike `state`, this does not check for new faults
        facts = tuple(controller_facts(self.connections.reported))
        return self._guard.last_known(self._readings.newest(streaming=streaming), facts)

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        return hold_active(self, timeout_s)

    @property
    def controller(self) -> ControllerCommands:
        """Controller commands for tool, base and override, and access to the controller state."""
        return ControllerCommands(self._guard, lambda: self.connections.eki)

    @property
    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        """Most recent stream cycles, oldest first; frozen once a fault is latched."""
        return link.recorded_cycles() if (link := self.connections.open_link) is not None else ()

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
        self._enter_active(stop_count)

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
        self._enter_active(stop_count)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop the arm and end the RSI program; raises any fault that occurs meanwhile."""
        self._watch.check_until_certain()
        self._guard.require("deactivate", RUNNING)
        deadline = time.monotonic() + timeout_s
        if self.connections.link.state.moving:
            self.stop(StopKind.HOLD, timeout_s)
            self._follower.await_end(remaining_s(deadline))
        try:
            self.connections.end_stream(deadline)
        except RonnaError as error:
            self._watch.latch(error)
            raise
        final_state = self.connections.link.state
        if self._guard.state is Lifecycle.FAULT:  # it must be acknowledged, although the program has ended
            self._watch.raise_any()
        self._guard.enter(
            Lifecycle.CONFIGURED,
            cycles=final_state.cycles,
            late=final_state.late,
            lost=final_state.lost,
            rejected=final_state.rejected,
            foreign=final_state.foreign,
        )

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

    def close(self) -> None:
        """Stop the arm, end the RSI program and disconnect, within a bounded time; never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        connections = self.connections
        with contextlib.suppress(Exception):
            link = connections.open_link
            if link is not None and link.alive and link.state.phase in (Phase.RUNNING, Phase.FAULT):
                link.stop(StopOrder.HOLD)
                link.wait(lambda s: not s.moving, CLOSING_STOP_S)
                self._follower.await_end(CLOSING_STOP_S)
                connections.end_stream(time.monotonic() + CLOSING_STOP_S)
        connections.close_eki()  # first: its reader uses the link's memory
        connections.close_link()
        self._guard.enter(Lifecycle.CLOSED)

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

    def link_statistics(self) -> LinkStatistics:
        """Return the link statistics since the last `activate`."""
        self._guard.require("link_statistics", (*READABLE, Lifecycle.FAULT))
        link = self.connections.open_link
        if link is None:
            return link_statistics(NO_STATE, ())
        return link_statistics(
            link.state, link.mailbox.read_histogram(), link.mailbox.read_jitter_histogram()
        )

    def move_joints(
        self, target_rad: JointVector, *, speed_fraction: float = 1.0, timeout_s: float = 60.0
    ) -> ArmReading:
        return self._move("move_joints", JointMove(target_rad, speed_fraction), timeout_s)

    def move_linear(
        self,
        target: Transform,
        *,
        flange_from_tool: Transform | None = None,
        speed_fraction: float = 1.0,
        timeout_s: float = 60.0,
    ) -> ArmReading:
        return self._move("move_linear", LineMove(target, flange_from_tool, speed_fraction), timeout_s)

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        if start_rad is None:
            current_reading = self.read_state()
            start_rad = (
                current_reading.commanded_rad or current_reading.joints_rad
            )  # nothing is commanded before the stream runs
        return self._planner.preview(motion, start_rad, self.operating_mode)

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        """Stop the arm; `timeout_s` is host time. All kinds except HOLD latch a fault."""
        self._watch.check()
        self._guard.require("stop", (Lifecycle.CONFIGURED, *RUNNING, Lifecycle.FAULT))  # also a start
        link = self.connections.open_link
        if link is None or not link.alive:
            return  # nothing is moving the arm
        # First: from now on `_move` finds HOLD, or has read the number of an earlier stop and is refused.
        was_held = self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
        number = link.stop(_STOP_ORDERS[kind])
        was_held = (
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD) or was_held
        )  # a start that ended meanwhile
        rest_state = self._follower.wait(
            lambda s: (s.stop_number >= number and not s.moving) or s.phase is Phase.IDLE, timeout_s
        )
        if kind is StopKind.DRIVES_OFF:
            self.connections.eki.require(CommandName.DRIVES, timeout_s, On=0)
        if rest_state is None and not link.state.fault:
            if was_held:  # HOLD means an arm at rest; the order remains, and no motion starts before that
                self._guard.exchange(Lifecycle.HOLD, Lifecycle.ACTIVE)
            raise MotionNotFinished(f"{self._name}: the arm does not come to rest", limit=f"{timeout_s:g} s")
        self._watch.check_until_certain()

    def resume(self) -> None:
        self._watch.raise_new()
        self._guard.require("resume", RUNNING)
        self._guard.enter(Lifecycle.ACTIVE)

    def surround(self, surroundings: Surroundings) -> None:
        self._planner.surroundings = surroundings

    def _move(self, call: str, motion: Motion, timeout_s: float) -> ArmReading:
        self._watch.raise_new()
        open_link = self.connections.open_link
        stop_count = (
            0 if open_link is None else open_link.stop_number
        )  # before the state is checked: see `stop`
        self._guard.require(call, (Lifecycle.ACTIVE,))
        link, mode = self.connections.link, _operating_mode(self._watch.mode)
        planned = self._planner.plan(motion, link.state.commanded_rad, mode)
        link.surround(self._planner.surroundings)
        clear_plan = self._planner.clear_plan(planned, mode)
        return self._readings.from_stream(self._follower.follow(clear_plan, stop_count, timeout_s))

    def _enter_active(self, stop_count: int) -> None:
        """Enter ACTIVE, or HOLD if more than `stop_count` stops have been ordered."""
        self._guard.enter(Lifecycle.ACTIVE, mode=self._watch.mode)
        if self.connections.link.stop_number != stop_count:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)

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
