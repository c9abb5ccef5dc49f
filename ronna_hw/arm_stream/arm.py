"""Arm that moves by a stream of set-points: the calls of `RobotArm` that do not depend on the vendor."""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from typing import Protocol, Self

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import ForceLimitExceeded, ForceNotSensed
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm_stream.force import LEAST_REST_S
from ronna_hw.arm_stream.insertion import plan_insertion, travel_along_axis_mm
from ronna_hw.arm_stream.motion import MotionFollower, MotionPlanner
from ronna_hw.arm_stream.readings import StreamReadings
from ronna_hw.arm_stream.records import NO_STATE, Phase, RecordedCycle, StopOrder
from ronna_hw.arm_stream.statistics import link_statistics
from ronna_hw.arm_stream.watch import HasLink, StreamWatch
from ronna_hw.devices.contact import Inserted, Insertion
from ronna_hw.devices.lifecycle import READABLE, RUNNING, Lifecycle, LifecycleGuard, hold_active
from ronna_hw.devices.readings import ArmReading, LinkStatistics
from ronna_hw.devices.robot import JointMove, LineMove, Motion, OperatingMode, StopKind
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

TARE_LIMIT_S = 10.0  # host time; the motion is refused if it does not suffice
CLOSING_STOP_S = 1.0  # host time for the arm to come to rest in close()

_STOP_ORDERS = {
    StopKind.HOLD: StopOrder.HOLD,
    StopKind.PROTECTIVE: StopOrder.PROTECTIVE,
    StopKind.LINK: StopOrder.LINK,
    StopKind.DRIVES_OFF: StopOrder.DRIVES_OFF,
}


class StreamConnections(HasLink, Protocol):
    """Connections of an arm that is driven by a stream."""

    def end_stream(self, deadline: float) -> None:
        """End the controller's program and close the stream."""
        ...

    def close_link(self) -> None:
        """Stop the real-time process, if running."""
        ...

    def close_control(self) -> None:
        """Close the other channels to the controller, if open."""
        ...


class StreamedArm(ABC):
    """Part of an arm that its stream defines; a driver adds how it connects, starts and recovers."""

    notices: tuple[str, ...] = ()
    senses_force: bool = False
    _name: str
    _guard: LifecycleGuard
    _kinematics: Kinematics
    _planner: MotionPlanner
    _follower: MotionFollower
    _readings: StreamReadings
    _streams: StreamConnections
    _watching: StreamWatch

    @property
    @abstractmethod
    def operating_mode(self) -> OperatingMode:
        """Operating mode of the running stream, or the last reported mode."""

    @abstractmethod
    def _stream_mode(self) -> OperatingMode:
        """Return the operating mode in which the stream was started."""

    @abstractmethod
    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Read the measured joint angles."""

    @abstractmethod
    def _switch_drives_off(self, timeout_s: float) -> None:
        """Ask the controller to switch its drives off."""

    @property
    def name(self) -> str:
        return self._name

    @property
    def state(self) -> Lifecycle:
        self._watching.check_until_certain()
        return self._guard.state

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, if any."""
        self._watching.check_until_certain()
        return self._guard.fault

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        return self._planner.limits(mode or self.operating_mode)

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        return hold_active(self, timeout_s)  # type: ignore[type-var]  # the driver completes the device

    @property
    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        """Most recent stream cycles, oldest first; frozen once a fault is latched."""
        return link.recorded_cycles() if (link := self._streams.open_link) is not None else ()

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop the arm and end the controller's program; raises any fault that occurs meanwhile."""
        self._watching.check_until_certain()
        self._guard.require("deactivate", RUNNING)
        deadline = time.monotonic() + timeout_s
        if self._streams.link.state.moving:
            self.stop(StopKind.HOLD, timeout_s)
            self._follower.await_end(max(deadline - time.monotonic(), 0.0))
        try:
            self._streams.end_stream(deadline)
        except RonnaError as error:
            self._watching.latch(error)
            raise
        final_state = self._streams.link.state
        if self._guard.state is Lifecycle.FAULT:  # it must be acknowledged, although the program has ended
            self._watching.raise_any()
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
        streams = self._streams
        with contextlib.suppress(Exception):
            link = streams.open_link
            if link is not None and link.alive and link.state.phase in (Phase.RUNNING, Phase.FAULT):
                link.stop(StopOrder.HOLD)
                link.wait(lambda s: not s.moving, CLOSING_STOP_S)
                self._follower.await_end(CLOSING_STOP_S)
                streams.end_stream(time.monotonic() + CLOSING_STOP_S)
        streams.close_control()  # first: its reader uses the link's memory
        streams.close_link()
        self._guard.enter(Lifecycle.CLOSED)

    def link_statistics(self) -> LinkStatistics:
        """Return the link statistics since the last `activate`."""
        self._guard.require("link_statistics", (*READABLE, Lifecycle.FAULT))
        link = self._streams.open_link
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

    def insert(self, insertion: Insertion, *, timeout_s: float = 120.0) -> Inserted:
        limit_N = insertion.force_limit_N
        if limit_N is not None and not self.senses_force:
            raise ForceNotSensed(
                f"{self._name}: this arm does not sense the force on its tool", limit=f"{limit_N:g} N"
            )
        self._watching.raise_new()
        self._guard.require("insert", (Lifecycle.ACTIVE,))
        if limit_N is not None:
            self._await_tare()
        start_rad = self._streams.link.state.commanded_rad
        line = plan_insertion(self._kinematics, start_rad, insertion, self.limits(self._stream_mode()))
        before = self.read_state().joints_rad
        reading = self._move("insert", line, timeout_s, limit_N or 0.0)
        travel_mm = travel_along_axis_mm(self._kinematics, before, reading.joints_rad, insertion)
        peak_N = self._streams.link.state.peak_force_N if limit_N is not None else None
        return Inserted(reading, travel_mm, peak_N)

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        if start_rad is None:
            current_reading = self.read_state()
            start_rad = (
                current_reading.commanded_rad or current_reading.joints_rad
            )  # nothing is commanded before the stream runs
        return self._planner.preview(motion, start_rad, self.operating_mode)

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        """Stop the arm; `timeout_s` is host time. All kinds except HOLD latch a fault."""
        self._watching.check()
        self._guard.require("stop", (Lifecycle.CONFIGURED, *RUNNING, Lifecycle.FAULT))  # also a start
        link = self._streams.open_link
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
            self._switch_drives_off(timeout_s)
        if rest_state is None and not link.state.fault:
            if was_held:  # HOLD means an arm at rest; the order remains, and no motion starts before that
                self._guard.exchange(Lifecycle.HOLD, Lifecycle.ACTIVE)
            raise self._follower.not_at_rest_error(timeout_s)
        self._watching.check_until_certain()

    def resume(self) -> None:
        self._watching.raise_new()
        self._guard.require("resume", RUNNING)
        self._guard.enter(Lifecycle.ACTIVE)

    def surround(self, surroundings: Surroundings) -> None:
        self._planner.surroundings = surroundings

    def _move(self, call: str, motion: Motion, timeout_s: float, force_limit_N: float = 0.0) -> ArmReading:
        self._watching.raise_new()
        open_link = self._streams.open_link
        stop_count = (
            0 if open_link is None else open_link.stop_number
        )  # before the state is checked: see `stop`
        self._guard.require(call, (Lifecycle.ACTIVE,))
        link, mode = self._streams.link, self._stream_mode()
        planned = self._planner.plan(motion, link.state.commanded_rad, mode)
        link.surround(self._planner.surroundings)
        clear_plan = self._planner.clear_plan(planned, mode)
        try:
            state = self._follower.follow(clear_plan, stop_count, timeout_s, force_limit_N)
        except ForceLimitExceeded:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
            raise
        return self._readings.from_stream(state)

    def _await_tare(self) -> None:
        """Wait until the force on the resting tool is known."""
        link = self._streams.link
        begin, cycle_s = link.state.cycles, self.limits(self._stream_mode()).cycle_s
        needed = 1 + round(LEAST_REST_S / cycle_s)
        self._follower.wait(lambda s: bool(s.fault) or s.cycles - begin > needed, TARE_LIMIT_S)

    def _enter_active(self, stop_count: int, **facts: object) -> None:
        """Enter ACTIVE, or HOLD if more than `stop_count` stops have been ordered."""
        self._guard.enter(Lifecycle.ACTIVE, **facts)
        if self._streams.link.stop_number != stop_count:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
