"""Vendor-neutral `RobotArm` driven by a stream of set-points."""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any, Generic

from ronna_hw.arguments import require_time_s
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import FORCE_NOT_SENSED, ForceLimitExceeded
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm_stream.connections import StreamConnections, remaining_s
from ronna_hw.arm_stream.control_channel import S
from ronna_hw.arm_stream.force import LEAST_REST_S
from ronna_hw.arm_stream.insertion import drill_watch, has_begun, plan_insertion, travel_along_axis_mm
from ronna_hw.arm_stream.load_sums import NO_SIGNALS, LoadMeans, mean_loads
from ronna_hw.arm_stream.mailbox import MailboxTorn
from ronna_hw.arm_stream.motion import MotionFollower, MotionPlanner
from ronna_hw.arm_stream.readings import StreamReadings
from ronna_hw.arm_stream.records import (
    NO_LIMIT,
    NO_STATE,
    ForceLimit,
    LinkState,
    RecordedCycle,
    StopOrder,
    StreamPhase,
)
from ronna_hw.arm_stream.statistics import link_statistics
from ronna_hw.arm_stream.watch import StreamWatch
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads
from ronna_hw.devices.capabilities import ByteSink, Fact, StreamCycles
from ronna_hw.devices.contact import Drilled, DrillLimits, Inserted, Insertion
from ronna_hw.devices.lifecycle import (
    READABLE,
    RUNNING,
    GuardedDevice,
    Identity,
    LastKnown,
    Lifecycle,
    LifecycleGuard,
    require_person,
)
from ronna_hw.devices.reading_stream import NextArmState, ReadingStream
from ronna_hw.devices.readings import ArmReading, LinkStatistics, ToolIdentity, Validity
from ronna_hw.devices.robot import (
    STOP_LIMIT_S,
    JointMove,
    Motion,
    OperatingMode,
    StopKind,
    require_motion,
    stop_mistake,
)
from ronna_hw.errors import RonnaError
from ronna_hw.host.process import defer_interruption
from ronna_hw.vectors import JointVector

TARE_LIMIT_S = 10.0  # host time; the motion is refused if it does not suffice
REPLY_LIMIT_S = 0.5  # host time: connections silent for longer are reopened in a recovery
LIVE_HEARTBEAT_S = 0.2  # largest age of the real-time process' last heartbeat for it to be worth contacting
CLOSING_STOP_S = 1.0  # host time for the arm to come to rest in close()


class StreamedArm(GuardedDevice, ABC, Generic[S]):
    """Arm that its stream defines; a driver adds its connections, its start and its controller's words."""

    notices: tuple[str, ...] = ()
    senses_force: bool = False
    force_error_N: float = 0.0

    def __init__(
        self,
        guard: LifecycleGuard,
        connections: StreamConnections[S, Any],
        watch: StreamWatch[S],
        limits: MotionLimits,
    ) -> None:
        super().__init__(connections.faults.name, guard)
        self.connections = connections
        self._watch = watch
        self._planner = MotionPlanner(self._name, connections.faults.arm, limits)
        self._follower = MotionFollower(connections, watch, limits.cycle_s)
        self._readings = StreamReadings(connections, senses_force=self.senses_force)
        self._stated: tuple[S | None, tuple[Fact, ...]] = None, ()  # the last state, and its facts
        self._drilled: Drilled | None = None

    @abstractmethod
    def _start_stream(self, timeout_s: float) -> None:
        """Start the controller's program and its stream, and note the operating mode in the watch."""

    @abstractmethod
    def _stream_mode(self) -> OperatingMode:
        """Return the operating mode in which the stream was started."""

    @abstractmethod
    def _reported_mode(self, state: S) -> OperatingMode:
        """Return the operating mode in a state of the controller."""

    @abstractmethod
    def _tool_number(self, state: S) -> int:
        """Return the tool number in a state of the controller; 0 means no tool."""

    @abstractmethod
    def _controller_facts(self, state: S) -> Iterable[Fact]:
        """Return what a state of the controller says about its readiness."""

    @abstractmethod
    def _name_loads(self, loads: AxisLoads, means: LoadMeans) -> AxisLoads:
        """Enter means of the load signals under what the controller states."""

    @abstractmethod
    def _is_to_acknowledge(self, timeout_s: float) -> bool:
        """Return whether the controller shows a state of an earlier run that a person must acknowledge."""

    @abstractmethod
    def _switch_drives_off(self, timeout_s: float) -> None:
        """Ask the controller to switch its drives off."""

    @property
    def kinematics(self) -> Kinematics:
        """Kinematics of this individual arm once connected, nominal before."""
        return self.connections.faults.arm

    @property
    def operating_mode(self) -> OperatingMode:
        reported = None if self._guard.state in RUNNING else self.connections.reported
        return self._stream_mode() if reported is None else self._reported_mode(reported)

    @property
    def state(self) -> Lifecycle:
        self._watch.check_until_certain()
        return self._guard.state

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, if any."""
        self._watch.check_until_certain()
        return self._guard.fault

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        return self._planner.limits(mode or self.operating_mode)

    @property
    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        """Most recent stream cycles, oldest first; frozen once a fault is latched."""
        return link.recorded_cycles() if (link := self.connections.open_link) is not None else ()

    def cycles_since(self, after_ns: int) -> StreamCycles | None:
        """Return the kept cycles that came after a host monotonic time, or None without a stream."""
        from ronna_hw.arm_stream.cycle_rows import read_cycles  # with NumPy

        link = self.connections.open_link
        with contextlib.suppress(ValueError, MailboxTorn):  # another thread may be closing it
            return None if link is None else read_cycles(link.mailbox, after_ns)
        return None

    def observe(self) -> LastKnown[ArmReading]:
        streaming = self._guard.state in RUNNING  # unlike `state`, this does not check for new faults
        if (reported := self.connections.reported) is not self._stated[0]:
            self._stated = reported, () if reported is None else tuple(self._controller_facts(reported))
        reading, stopped = self._readings.newest(streaming=streaming)
        return self._guard.last_known(reading, self._stated[1], stopped=stopped)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self.connections.recorder = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open the control channel, and identify arm and controller."""
        self._guard.require("connect", (Lifecycle.DISCONNECTED,))
        identity = self._find_controller(timeout_s)
        self._guard.enter(Lifecycle.CONNECTED, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Start the real-time process."""
        self._guard.require("configure", (Lifecycle.CONNECTED,))
        self.connections.start_link(timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start the controller's program, and return once it follows the stream.

        Errors after the start are latched; `recover` clears them. A stop during the start leaves the arm in
        HOLD.
        """
        self._guard.require("activate", (Lifecycle.CONFIGURED,))
        stop_count = self.connections.link.stop_number
        self._start(timeout_s)
        self._enter_active(stop_count, mode=self._watch.mode)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED: end the stream, acknowledge its cause, check the controller.

        Moves nothing. The person named has found the cause at the arm. Broken or silent connections are
        reopened, with retries until the time limit. While CONNECTED what is left of an earlier run is
        acknowledged, and the state stays CONNECTED. Raises what prevents it; a fault then stays latched.
        """
        self._watch.check()
        person = require_person(acknowledged_by)
        deadline = time.monotonic() + timeout_s
        connections = self.connections
        if self._guard.state is Lifecycle.CONNECTED and self._is_to_acknowledge(timeout_s):
            connections.acknowledge(person, deadline)
            return
        self._guard.require("recover", (Lifecycle.FAULT,))
        if not connections.is_answering(REPLY_LIMIT_S):
            self._find_controller(remaining_s(deadline), retry=True)
        if (link := connections.open_link) is not None:
            if link.alive and link.stalled_s < LIVE_HEARTBEAT_S:
                with contextlib.suppress(RonnaError):
                    connections.end_stream(time.monotonic() + 0.5 * remaining_s(deadline))
            connections.close_link()
        connections.acknowledge(person, deadline)
        if not connections.is_answering(REPLY_LIMIT_S):  # what was acknowledged may have closed them
            self._find_controller(remaining_s(deadline), retry=True)
        connections.start_link(max(remaining_s(deadline), REPLY_LIMIT_S))
        self._guard.enter(Lifecycle.CONFIGURED)

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Read the measured joint angles, from a running stream or otherwise by the control channel."""
        self._require("read_state", READABLE)
        if self._guard.state in RUNNING:
            return self._readings.from_stream(self.connections.link.state)
        return self._readings.from_controller(self._request_state(timeout_s))

    def stream(self, timeout_s: float = 1.0) -> ReadingStream[ArmReading]:
        """Stream states of different cycles: the newest at each look, not every one.

        The recorded bytes of the link have every cycle.
        """
        return ReadingStream(NextArmState(self), timeout_s=timeout_s)

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Read the tool number from the controller's inputs; 0 means no tool."""
        self._require("read_tool_identity", READABLE)
        number = self._tool_number(self._request_state(timeout_s))
        return ToolIdentity(self._readings.stamp(), number)

    def read_loads(
        self, cycles: int = LOAD_CYCLES, timeout_s: float = 2.0, *, since_rest: bool = False
    ) -> AxisLoads:
        """Average the load signals of cycles at rest; MISSING if the stream carries none."""
        self._require("read_loads", RUNNING)
        deadline = time.monotonic() + timeout_s
        before = after = self.connections.link.state
        if not after.carries_loads:
            reading = self._readings.from_stream(after)
            return AxisLoads(reading.stamp, Validity.MISSING, reading.joints_rad, 0)
        if since_rest:
            before = replace(after, load_cycles=0, load_sums=NO_SIGNALS)
        while not _has_rested(before, after, cycles):
            before = after  # once more, if the arm has moved meanwhile
            ended = partial(_has_ended, before, cycles=cycles)
            state = self._follower.wait(ended, max(deadline - time.monotonic(), 0.0))
            self._watch.raise_any()
            if state is None or time.monotonic() > deadline:
                raise self._follower.not_at_rest_error(timeout_s)
            after = state
        reading = self._readings.from_stream(after)
        means = mean_loads(before, after)
        loads = AxisLoads(reading.stamp, reading.validity, reading.joints_rad, means.cycles)
        return self._name_loads(loads, means)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop the arm and end the controller's program; raises any fault that occurs meanwhile."""
        self._watch.check_until_certain()
        self._guard.require("deactivate", RUNNING)
        deadline = time.monotonic() + timeout_s
        if self.connections.link.state.moving:
            self.stop(StopKind.HOLD, timeout_s)
            self._follower.await_end(max(deadline - time.monotonic(), 0.0))
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

    def close(self) -> None:
        """Stop the arm, end the controller's program and disconnect, in bounded time; never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        connections = self.connections
        with contextlib.suppress(Exception):
            link, streaming = connections.open_link, (StreamPhase.RUNNING, StreamPhase.FAULT)
            if link is not None and link.alive and link.state.phase in streaming:
                link.stop(StopOrder.HOLD)
                link.wait(lambda s: not s.moving, CLOSING_STOP_S)
                self._follower.await_end(CLOSING_STOP_S)
                connections.end_stream(time.monotonic() + CLOSING_STOP_S)
        connections.close_control()  # first: its reader uses the link's memory
        connections.close_link()
        self._guard.enter(Lifecycle.CLOSED)

    def link_statistics(self) -> LinkStatistics:
        """Return the link statistics since the last `activate`."""
        self._guard.require("link_statistics", (*READABLE, Lifecycle.FAULT))
        if (link := self.connections.open_link) is None:
            return link_statistics(NO_STATE, (), ())
        return link_statistics(link.state, *link.mailbox.read_histograms())

    def move(self, motion: Motion, *, timeout_s: float = 60.0) -> ArmReading:
        require_motion(motion)
        return self._move("move", motion, timeout_s)

    def insert(self, insertion: Insertion, *, timeout_s: float = 120.0) -> Inserted:
        if (limit_N := insertion.force_limit_N) is not None and not self.senses_force:
            raise FORCE_NOT_SENSED(
                f"{self._name}: this arm does not sense the force on its tool", limit=f"{limit_N:g} N"
            )
        self._drilled = None
        self._require("insert", (Lifecycle.ACTIVE,))
        if limit_N is not None:
            self._await_tare()
        start_rad = self.connections.link.state.commanded_rad
        line = plan_insertion(self.kinematics, start_rad, insertion, self.limits(self._stream_mode()))
        before = self.read_state().joints_rad
        goes_on = has_begun(self.kinematics, start_rad, insertion)
        drill = drill_watch(self.kinematics, start_rad, insertion)
        cycle_s, number = self.limits(self._stream_mode()).cycle_s, self.connections.link.state.command_number
        try:
            reading = self._move("insert", line, timeout_s, ForceLimit(limit_N or 0.0, goes_on, drill))
        finally:
            if insertion.drill is not None:
                self._drilled = self._read_drilled(insertion.drill, cycle_s, number)
        travel_mm = travel_along_axis_mm(self.kinematics, before, reading.joints_rad, insertion)
        peak_N = self.connections.link.state.peak_force_N if limit_N is not None else None
        return Inserted(reading, travel_mm, peak_N)

    @property
    def drilled(self) -> Drilled | None:
        return self._drilled

    def _read_drilled(self, limits: DrillLimits, cycle_s: float, before: int) -> Drilled | None:
        """Read how a drill was fed by a command after that number; None if none began, or it is not known."""
        try:
            state = self.connections.link.state
        except (RonnaError, OSError, ValueError, MailboxTorn):  # what ended the feed is reported
            return None
        if state.command_number == before or state.result.is_refused:
            return None
        return Drilled(
            joints_rad=state.measured_rad,
            peak_force_N=state.peak_force_N,
            side_force_N=state.side_force_N,
            met_bone=state.is_in_bone,
            broke_through=state.is_through,
            free_mm=state.free_share * limits.free_mm,
            drilled_s=state.drilled_cycles * cycle_s,
            slowed_s=state.slowed_cycles * cycle_s,
            forces_N=state.drilled_N,
        )

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        require_motion(motion)
        if start_rad is None:
            reading = self.read_state()
            start_rad = reading.commanded_rad or reading.joints_rad  # before the stream nothing is commanded
        return self._planner.preview(motion, start_rad, self.operating_mode)

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = STOP_LIMIT_S) -> None:
        """Stop the arm; `timeout_s` is host time. All kinds except HOLD latch a fault.

        A wrong argument never keeps an arm moving: it stops at HOLD, and then the mistake is raised.
        """
        self._guard.require_own_process("stop")
        try:
            kind, timeout_s = StopKind(kind), require_time_s(timeout_s, "the time limit of stop")
        except ValueError as error:
            self._stop(StopKind.HOLD, STOP_LIMIT_S)
            raise stop_mistake(self._name, kind, timeout_s) from error
        self._stop(kind, timeout_s)

    def _stop(self, kind: StopKind, timeout_s: float) -> None:
        self._watch.check()
        self._guard.require("stop", (Lifecycle.CONFIGURED, *RUNNING, Lifecycle.FAULT))  # also a start
        link = self.connections.open_link
        if link is None or not link.alive:  # nothing is moving the arm
            if kind is StopKind.DRIVES_OFF:
                self._switch_drives_off(timeout_s)
            return
        # First: from now on `_move` finds HOLD, or has read the number of an earlier stop and is refused.
        was_held = self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
        number = link.stop(StopOrder[kind.name])
        # Once more, for a start that ended meanwhile.
        was_held = self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD) or was_held
        try:
            rest_state = self._follower.wait(
                lambda s: (s.stop_number >= number and not s.moving) or s.phase is StreamPhase.IDLE, timeout_s
            )
        finally:  # also if the process that sends our set-points has died meanwhile
            if kind is StopKind.DRIVES_OFF:
                self._switch_drives_off(timeout_s)
        if rest_state is None and not link.state.fault:
            if was_held:  # HOLD means an arm at rest; the order remains, and no motion starts before that
                self._guard.exchange(Lifecycle.HOLD, Lifecycle.ACTIVE)
            raise self._follower.not_at_rest_error(timeout_s)
        self._watch.check_until_certain()

    def resume(self) -> None:
        self._require("resume", RUNNING)
        self._guard.enter(Lifecycle.ACTIVE)

    def surround(self, surroundings: Surroundings) -> None:
        self._planner.surroundings = surroundings

    def _move(self, call: str, motion: Motion, timeout_s: float, force: ForceLimit = NO_LIMIT) -> ArmReading:
        self._watch.raise_new()
        open_link = self.connections.open_link
        # Before the state is checked: see `stop`.
        stop_count = 0 if open_link is None else open_link.stop_number
        self._guard.require(call, (Lifecycle.ACTIVE,))
        link, mode = self.connections.link, self._stream_mode()
        planned = self._planner.plan(motion, link.state.commanded_rad, mode)
        link.surround(self._planner.surroundings)
        clear_plan = self._planner.clear_plan(planned, mode)
        try:
            settles = not isinstance(motion, JointMove) or motion.settles
            state = self._follower.follow(clear_plan, stop_count, timeout_s, force, settles=settles)
        except ForceLimitExceeded:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
            raise
        except RonnaError:  # the arm is at rest, or in fault
            raise
        except BaseException as problem:  # such as Ctrl-C: nobody waits for the motion any more
            with defer_interruption():
                try:
                    self._stop(StopKind.HOLD, STOP_LIMIT_S)
                except RonnaError as error:
                    problem.add_note(f"{self._name} could not be stopped: {error}")
            raise
        return self._readings.from_stream(state)

    def _require(self, call: str, allowed: Iterable[Lifecycle]) -> None:
        """Raise a fault that no call has raised yet, or DEV-001 unless the state is one of `allowed`."""
        self._watch.raise_new()
        self._guard.require(call, allowed)

    def _find_controller(self, timeout_s: float, *, retry: bool = False) -> Identity:
        identity = self.connections.find_controller(timeout_s, self._watch, retry=retry)
        self._planner.kinematics = self.kinematics
        return identity

    def _request_state(self, timeout_s: float) -> S:
        try:
            return self.connections.request_state(timeout_s)
        except RonnaError:
            self._watch.check()
            raise

    def _start(self, timeout_s: float) -> None:
        try:
            self._start_stream(timeout_s)
        except RonnaError as error:
            self._watch.latch(error)
            raise

    def _await_tare(self) -> None:
        """Wait until the force on the resting tool is known."""
        link = self.connections.link
        begin, cycle_s = link.state.cycles, self.limits(self._stream_mode()).cycle_s
        needed = 1 + round(LEAST_REST_S / cycle_s)
        self._follower.wait(lambda s: bool(s.fault) or s.cycles - begin > needed, TARE_LIMIT_S)

    def _enter_active(self, stop_count: int, **facts: object) -> None:
        """Enter ACTIVE, or HOLD if more than `stop_count` stops have been ordered."""
        self._guard.enter(Lifecycle.ACTIVE, **facts)
        if self.connections.link.stop_number != stop_count:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)


def _has_rested(before: LinkState, after: LinkState, cycles: int) -> bool:
    """Return whether load signals of so many cycles of one standstill lie between two states."""
    return after.load_since == before.load_since and after.load_cycles - before.load_cycles >= cycles


def _has_ended(before: LinkState, state: LinkState, cycles: int) -> bool:
    """Return whether there is no use in waiting: they do, the arm has moved, or a fault stopped it."""
    moved = state.load_since != before.load_since
    return moved or bool(state.fault) or _has_rested(before, state, cycles)
