"""`KukaRsiArm`: a KR C4 arm as the `RobotArm` of a theatre."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import replace

from drivers.kuka_rsi import stream
from drivers.kuka_rsi.eki_client import EkiClient
from drivers.kuka_rsi.eki_state import ControllerState
from drivers.kuka_rsi.errors import (
    ControllerNotFound,
    LinkProcessDied,
    MotionNotFinished,
    MotionRefused,
    MotionStopped,
    NoTelegram,
)
from drivers.kuka_rsi.faults import axes_text, error_of_fault, error_of_refusal
from drivers.kuka_rsi.link_client import Condition, LinkClient
from drivers.kuka_rsi.link_state import (
    NO_STATE,
    CommandKind,
    Fault,
    LinkState,
    Phase,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.options import read_options
from drivers.kuka_rsi.turnaround import link_statistics
from ronna_hw.arm.limits import MotionLimits, working_limits
from ronna_hw.arm.model import ArmModel, arm_model, radians6
from ronna_hw.arm.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import READABLE, Identity, Lifecycle, LifecycleGuard
from ronna_hw.devices.readings import ArmReading, JointVector, LinkStatistics, Stamp, ToolIdentity, Validity
from ronna_hw.devices.robot import StopKind
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_context import load_context
from ronna_hw.wire.kuka_eki import CommandName

POLL_S = 0.5  # of host time between two looks at the theatre's time while a motion runs
CLOSING_STOP_S = 1.0  # host time that close() gives the arm to come to rest
STALE_S = 0.5  # age of a measured pose beyond which it is called stale, host time
STREAMING = (Lifecycle.ACTIVE, Lifecycle.HOLD)

_STOP_ORDERS = {
    StopKind.HOLD: StopOrder.HOLD,
    StopKind.PROTECTIVE: StopOrder.PROTECTIVE,
    StopKind.LINK: StopOrder.LINK,
    StopKind.DRIVES_OFF: StopOrder.DRIVES_OFF,
}


class KukaRsiArm:
    """Endpoints `rsi` (udp://, where this computer listens) and `eki_project` (tcp://, the controller)."""

    wire_protocol = "kuka-rsi-eki"  # which byte-level conformance cases apply

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Opens nothing. Raises CFG-001, CFG-002 or RSI-013 when the configuration is wrong."""
        self._name = name
        self._clock = clock
        self._options = read_options(name, config.options)
        self._rsi = config.address("rsi").require("udp")
        self._eki_address = config.address("eki_project").require("tcp")
        self._context = load_context()
        self._cycle_s = self._context.program.cycle_ms / 1000.0
        self._model = arm_model(self._options.variant)
        limits = working_limits(self._model, self._options.speed_fraction)
        line = self._options.line_speed_mm_s
        self._limits: MotionLimits = replace(limits, line_speed_mm_s=line) if line else limits
        self._guard = LifecycleGuard(name)
        self._eki: EkiClient | None = None
        self._link: LinkClient | None = None
        self._motion = threading.Lock()  # held while a motion is followed
        self._sequence = 0
        self._told: RonnaError | None = None  # the fault that a caller has already been given

    # Lifecycle

    @property
    def name(self) -> str:
        return self._name

    @property
    def state(self) -> Lifecycle:
        self._notice_fault()
        return self._guard.state

    @property
    def model(self) -> ArmModel:
        """The nominal kinematics that lines and limits are computed with."""
        return self._model

    @property
    def fault(self) -> RonnaError | None:
        """The error that latched FAULT, if any."""
        self._notice_fault()
        return self._guard.fault

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open the EKI channel and check that the controller runs our context for our arm.

        Raises EKI-001 when nothing answers, EKI-005 or EKI-006 when it is another controller or set-up.
        """
        self._guard.require("connect", (Lifecycle.DISCONNECTED,))
        identity = self._open_eki(timeout_s)
        self._guard.enter(Lifecycle.CONNECTED)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Start the real-time process, which takes the RSI port. Raises RSI-001."""
        self._guard.require("configure", (Lifecycle.CONNECTED,))
        self._open_link(timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start the RSI program and answer its telegrams; returns when corrections act.

        Raises EKI-007 when the controller is not ready, EKI-008 when it refuses, RSI-002 when no telegram
        comes, RSI-015 when RSI and EKI disagree about the axes. A failure is latched: `recover` leaves it.
        """
        self._guard.require("activate", (Lifecycle.CONFIGURED,))
        try:
            eki, link = self._the_eki, self._the_link
            stream.start_stream(eki, link, self._context, self._options, self._name, timeout_s)
        except RonnaError as error:
            self._latch(error)
            raise
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Bring the arm to rest and end the RSI program."""
        self._guard.require("deactivate", STREAMING)
        deadline = time.monotonic() + timeout_s
        if self._the_link.state.moving:
            self.stop(StopKind.HOLD, timeout_s)
        try:
            stream.end_stream(self._the_eki, self._the_link, deadline)
        except RonnaError as error:
            self._latch(error)
            raise
        self._guard.enter(Lifecycle.CONFIGURED)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """FAULT -> CONFIGURED: ends what runs, acknowledges the controller's messages, reads everything anew.

        Moves nothing. While CONNECTED a message of an earlier run is acknowledged, and the arm stays so.
        Raises what stands in the way, such as EKI-007; a fault then stays latched.
        """
        self._notice_fault()
        if not acknowledged_by.strip():
            raise ValueError("a recovery needs the name of the person who acknowledges the fault")
        deadline = time.monotonic() + timeout_s
        if self._guard.state is Lifecycle.CONNECTED and self._ask(timeout_s).error:
            stream.acknowledge(self._the_eki, self._context, self._options, deadline)
            return
        self._guard.require("recover", (Lifecycle.FAULT,))
        if self._eki is None or self._eki.failure is not None:
            self._close_eki()
            self._open_eki(timeout_s)
        if self._link is not None:
            if self._link.alive:
                with contextlib.suppress(RonnaError):
                    stream.end_stream(self._the_eki, self._link, deadline)
            self._close_link()
        stream.acknowledge(self._the_eki, self._context, self._options, deadline)
        self._open_link(stream.rest_of(deadline))
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Stop the arm, end the RSI program and the session. Bounded in time, never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        with contextlib.suppress(Exception):
            link = self._link
            if link is not None and link.alive and link.state.phase in (Phase.RUNNING, Phase.FAULT):
                link.stop(StopOrder.HOLD)
                link.wait(lambda s: not s.moving, CLOSING_STOP_S)
                stream.end_stream(self._the_eki, link, time.monotonic() + CLOSING_STOP_S)
        self._close_link()
        self._close_eki()
        self._guard.enter(Lifecycle.CLOSED)

    # Reading

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Measured axes: from the stream while it runs, otherwise asked by EKI."""
        self._raise_fault()
        self._guard.require("read_state", READABLE)
        if self._guard.state in STREAMING:
            return self._reading(self._the_link.state)
        state = self._ask(timeout_s)
        return ArmReading(
            self._stamp(0), Validity.OK, radians6(*state.axes_deg), commanded_rad=None, moving=state.moving
        )

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Number of the tool that the controller's inputs report; 0 is none."""
        self._raise_fault()
        self._guard.require("read_tool_identity", READABLE)
        return ToolIdentity(self._stamp(0), self._ask(timeout_s).tool)

    def link_statistics(self) -> LinkStatistics:
        """Health of the link since the last `activate`."""
        self._guard.require("link_statistics", (*READABLE, Lifecycle.FAULT))
        if self._link is None:
            return link_statistics(NO_STATE, ())
        return link_statistics(self._link.state, self._link.histogram(), self._link.jitter_histogram())

    @property
    def degraded(self) -> bool:
        """Whether the arm goes slower because cycles were lost."""
        return self._link is not None and self._link.state.degraded

    # Motion

    def move_joints(
        self, target_rad: JointVector, *, speed_fraction: float = 1.0, timeout_s: float = 60.0
    ) -> ArmReading:
        limits, link = self._ready_to_move("move_joints", speed_fraction)
        stops = link.stop_number
        return self._follow(
            plan_joint_move(self._model, link.state.commanded_rad, target_rad, limits), stops, timeout_s
        )

    def move_linear(
        self,
        target: Pose,
        *,
        tool_in_flange_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        speed_fraction: float = 1.0,
        timeout_s: float = 60.0,
    ) -> ArmReading:
        limits, link = self._ready_to_move("move_linear", speed_fraction)
        stops = link.stop_number
        return self._follow(
            plan_line(self._model, link.state.commanded_rad, target, limits, tool_in_flange_mm),
            stops,
            timeout_s,
        )

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        """Bring the arm to rest; `timeout_s` is host time. All kinds but HOLD are latched as a fault."""
        self._notice_fault()
        self._guard.require("stop", (*STREAMING, Lifecycle.FAULT))
        link = self._link
        if link is None or not link.alive:
            return  # nothing moves the arm
        number = link.stop(_STOP_ORDERS[kind])
        resting = self._await(
            lambda s: (s.stop_number >= number and not s.moving) or s.phase is Phase.IDLE, timeout_s
        )
        if kind is StopKind.DRIVES_OFF:
            self._the_eki.require(CommandName.DRIVES, timeout_s, On=0)
        if resting is None and not link.state.fault:
            raise MotionNotFinished(f"{self._name}: the arm does not come to rest", limit=f"{timeout_s:g} s")
        self._notice_fault()
        if self._guard.state is Lifecycle.ACTIVE:
            self._guard.enter(Lifecycle.HOLD)

    def resume(self) -> None:
        self._raise_fault()
        self._guard.require("resume", STREAMING)
        self._guard.enter(Lifecycle.ACTIVE)

    def _ready_to_move(self, call: str, speed_fraction: float) -> tuple[MotionLimits, LinkClient]:
        self._raise_fault()
        self._guard.require(call, (Lifecycle.ACTIVE,))
        return self._limits.slowed(speed_fraction), self._the_link

    def _follow(self, plan: MotionPlan, stops: int, timeout_s: float) -> ArmReading:
        if not self._motion.acquire(blocking=False):
            raise MotionRefused(f"{self._name}: another motion is under way")
        try:
            return self._carry_out(plan, stops, timeout_s)
        finally:
            self._motion.release()

    def _carry_out(self, plan: MotionPlan, stops: int, timeout_s: float) -> ArmReading:
        link = self._the_link
        number = link.command(CommandKind.MOVE, plan, stops)
        begun = link.state.cycles

        def ended(state: LinkState) -> bool:
            if state.fault:
                return not state.moving
            return state.command_number >= number and state.result is not Result.RUNNING

        while (state := self._await(ended, POLL_S)) is None:
            # The controller's cycles are theatre time; when none come, silence trips.
            waited_s = (link.state.cycles - begun) * self._cycle_s
            if waited_s > timeout_s:
                link.stop(StopOrder.HOLD)
                self._await(lambda s: not s.moving, CLOSING_STOP_S)
                raise MotionNotFinished(
                    f"{self._name}: the motion did not end or settle",
                    limit=f"{timeout_s:g} s",
                    last=axes_text(link.state),
                )
        self._notice_fault()
        if (fault := self._guard.fault) is not None:
            self._told = fault
            raise fault
        if state.result is Result.STOPPED:
            raise MotionStopped(f"{self._name}: stopped on the way", last=axes_text(state))
        if state.result is not Result.DONE:
            raise error_of_refusal(self._name, state)
        return self._reading(state)

    def _open_eki(self, timeout_s: float) -> Identity:
        variant = self._options.variant
        self._eki, identity = stream.open_controller(self._eki_address, self._context, variant, timeout_s)
        return identity

    def _open_link(self, timeout_s: float) -> None:
        self._link = LinkClient(stream.link_settings(self._rsi, self._context, self._options), timeout_s)

    def _close_eki(self) -> None:
        if self._eki is not None:
            self._eki.close()
            self._eki = None

    def _close_link(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _await(self, condition: Condition, timeout_s: float) -> LinkState | None:
        try:
            return self._the_link.wait(condition, timeout_s)
        except LinkProcessDied as error:
            self._latch(error)
            raise

    @property
    def _the_eki(self) -> EkiClient:
        if self._eki is None:
            raise ControllerNotFound(f"{self._name}: there is no EKI session")
        return self._eki

    @property
    def _the_link(self) -> LinkClient:
        if self._link is None:
            raise NoTelegram(f"{self._name}: there is no real-time process")
        return self._link

    def _notice_fault(self) -> None:
        """Latch what the real-time process or the EKI channel has found wrong meanwhile."""
        if self._guard.state not in STREAMING:
            if self._eki is not None and self._eki.failure and self._guard.state in READABLE:
                self._guard.latch(self._eki.failure)
            return
        link = self._the_link
        state = link.state
        latest = self._eki.latest if self._eki is not None else None
        error = error_of_fault(
            self._name,
            state,
            self._options,
            link.recorded_cycles() if state.fault is Fault.MONITOR else (),
            latest.error if latest is not None else 0,
        )
        if error is None and not link.alive:
            error = link.death()
        if error is None and self._eki is not None:
            error = self._eki.failure
        if error is not None:
            self._guard.latch(error)

    def _latch(self, error: RonnaError) -> None:
        """Latch an error that is about to be raised."""
        self._guard.latch(error)
        self._told = self._guard.fault

    def _raise_fault(self) -> None:
        """Raise a latched fault to the first call that meets it; later calls are refused and name it."""
        self._notice_fault()
        fault = self._guard.fault
        if fault is not None and fault is not self._told:
            self._told = fault
            raise fault

    def _ask(self, timeout_s: float) -> ControllerState:
        try:
            return self._the_eki.status(timeout_s)
        except RonnaError:
            self._notice_fault()
            raise

    def _reading(self, state: LinkState) -> ArmReading:
        age_s = (time.monotonic_ns() - state.received_ns) / 1e9
        limit_s = max(STALE_S, self._options.silence_limit_s)
        return ArmReading(
            self._stamp(state.IPOC),
            Validity.OK if age_s <= limit_s else Validity.STALE,
            state.measured_rad,
            state.commanded_rad,
            state.moving or not state.settled,
        )

    def _stamp(self, device_clock: int) -> Stamp:
        self._sequence += 1
        return Stamp(self._sequence, device_clock, self._clock.now_s())
