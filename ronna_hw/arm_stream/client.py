"""Driver side of the real-time process: start, heartbeat, orders and results."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.arm_stream.mailbox import KeptCycle, Mailbox
from ronna_hw.arm_stream.records import (
    Command,
    LinkState,
    OpenStream,
    RecordedCycle,
    Request,
    StopOrder,
    StreamPhase,
    StreamSettings,
)
from ronna_hw.clock import Clock, HostClock
from ronna_hw.devices.capabilities import ByteSink, Direction, PassedBytes
from ronna_hw.errors import DeviceError, is_error
from ronna_hw.host.process import describe_exit, shield_children

START_TIMEOUT_S = 10.0
HEARTBEAT_S = 0.05
# Theatre time that may pass while a state is awaited: more than lock-step can cover in a heartbeat of host
# time, so that a waiting motion never finds the controller at rest.
PASSING_S = 10.0
END_TIMEOUT_S = 2.0  # for the process to bring the arm to rest and exit, once its input was closed
LONGEST_MESSAGE = 4000
END_CAUSE_ADVICE = "Find out what ends it (a signal, the memory, a resource limit), then start again."


class StartRefused(Exception):
    """The real-time process could not open its link: number of the system's error, or 0."""

    def __init__(self, errno: int) -> None:
        super().__init__(errno)
        self.errno = errno


Condition = Callable[[LinkState], bool]
TrafficHandler = Callable[[list[KeptCycle], int], None]  # called with cycles, and the number of bytes lost


class LinkClient:
    """Client of the real-time process and its mailbox; thread-safe."""

    def __init__(
        self,
        settings: StreamSettings,
        module: str,
        errors: StreamErrors,
        timeout_s: float = START_TIMEOUT_S,
        on_traffic: TrafficHandler | None = None,
        clock: Clock | None = None,
        inherited: tuple[int, ...] = (),
    ) -> None:
        """Start the real-time process `module`; raises `errors.not_started`, or `StartRefused` by the system.

        `inherited` descriptors are passed on. `on_traffic` is called from a thread of this object with the
        link's traffic. Theatre time passes on `clock` during waits: the controller must go on for what is
        awaited.
        """
        self._errors = errors
        self._clock = HostClock() if clock is None else clock
        self._memory_fd = os.memfd_create("arm stream")
        self._event_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        Mailbox.initialise(self._memory_fd)
        self.mailbox = Mailbox(self._memory_fd)
        self._settings = replace(
            settings,
            mailbox_fd=self._memory_fd,
            event_fd=self._event_fd,
            keeps_pace=self._clock.paced,
            keeps_bytes=on_traffic is not None,
        )
        self._on_traffic = on_traffic
        self.surroundings = Surroundings()  # used to monitor the next motions
        self._lock = threading.Lock()
        self._changed = threading.Condition()
        self._end_reason: str | None = None
        self._last_words = ""  # of a process that ended by itself
        self._command_count = 0
        self.stop_number = 0  # of the last stop ordered
        self._stop_kind = StopOrder.HOLD  # the strongest since the stream was opened
        self._closing = threading.Event()
        with shield_children():
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", module],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
                pass_fds=(self._memory_fd, self._event_fd, *inherited),
            )
        self._heartbeat_thread = threading.Thread(
            target=self._run_heartbeat, name="arm heartbeat", daemon=True
        )
        try:
            self._start(timeout_s)
        except BaseException:  # including interruptions: the real-time process ends with its client
            self.close()
            raise

    @property
    def state(self) -> LinkState:
        """Last state published by the process."""
        return self.mailbox.read_state()

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self.process.poll() is None

    @property
    def stalled_s(self) -> float:
        """Host time since the last report of the process; reports come every 20 ms."""
        heartbeat_ns = self.mailbox.read_alive_ns()
        return (time.monotonic_ns() - heartbeat_ns) / 1e9 if heartbeat_ns else 0.0

    def command(self, request: Request, stop_number: int | None = None) -> int:
        """Send a command; return its number. Any stop after `stop_number` overrides a motion."""
        with self._lock:
            self._command_count += 1
            if isinstance(request, OpenStream):
                self._stop_kind = StopOrder.HOLD
            known_stop = self.stop_number if stop_number is None else stop_number
            self.mailbox.write_command(Command(self._command_count, request, known_stop, self.surroundings))
            return self._command_count

    def surround(self, surroundings: Surroundings) -> None:
        """Set the surroundings for clearance monitoring of later motions."""
        if surroundings != self.surroundings:  # the real-time process reads only changes
            self.surroundings = surroundings

    def stop(self, kind: StopOrder) -> int:
        """Order a stop that takes effect with the next reply, and return its number.

        A weaker stop does not replace a stronger one of the same stream: the process may not have seen it.
        """
        with self._lock:
            self.stop_number += 1
            self._stop_kind = max(kind, self._stop_kind)
            self.mailbox.order_stop(self.stop_number, self._stop_kind)
            return self.stop_number

    def wait(self, condition: Condition, timeout_s: float) -> LinkState | None:
        """Wait for a state that meets a condition; returns None on time-out (host time).

        Raises the driver's error when the process has ended.
        """
        deadline = time.monotonic() + timeout_s
        lets_time_pass = False
        try:
            with self._changed:
                while True:
                    state = self.state
                    if condition(state):
                        return state
                    if not self.alive:
                        raise self.death_error()
                    if (remaining_s := deadline - time.monotonic()) <= 0.0:
                        return None
                    lets_time_pass = True
                    self._clock.let_pass(PASSING_S)
                    self._changed.wait(min(remaining_s, HEARTBEAT_S))
        finally:
            if lets_time_pass:
                self._clock.hold_back()

    def death_error(self) -> DeviceError:
        """Build the error for a process that terminated unexpectedly."""
        if self._end_reason is None:
            self._end_reason = self._read_end_reason()
        error = self._errors.died(f"the real-time process ended: {self._end_reason}")
        if self._last_words:
            error.attachments["real-time-process.txt"] = self._last_words
        return error

    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        """Return the most recent cycles, oldest first; frozen while a fault is latched."""
        return self.mailbox.read_records()

    def close(self) -> None:
        """End the process, which stops the arm first; bounded in time, repeatable, never raises."""
        if self._closing.is_set():
            return
        self._closing.set()
        os.eventfd_write(self._event_fd, 1)  # wakes the heartbeat
        with contextlib.suppress(OSError):
            if self.process.stdin is not None:
                self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_TIMEOUT_S)
        if self.alive:
            self.process.kill()
            self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()
        if self._heartbeat_thread.is_alive():
            self._heartbeat_thread.join()
        self._deliver_traffic()  # traffic during the end of the process
        self.mailbox.close()
        os.close(self._memory_fd)
        os.close(self._event_fd)

    def _start(self, timeout_s: float) -> None:
        stdin = self.process.stdin
        with contextlib.suppress(BrokenPipeError):
            if stdin is not None:
                stdin.write(self._settings.to_json().encode() + b"\n")
                stdin.flush()
        self._heartbeat_thread.start()
        try:
            state = self.wait(lambda s: s.phase is not StreamPhase.STARTING, timeout_s)
        except DeviceError as error:
            if not is_error(error, self._errors.died):
                raise
            raise self._errors.not_started(error.what, action=END_CAUSE_ADVICE) from None
        if state is None:
            raise self._errors.not_started("the real-time process does not report", limit=f"{timeout_s:g} s")
        if state.phase is StreamPhase.FAILED:
            raise StartRefused(state.errno)

    def _run_heartbeat(self) -> None:
        count = 0
        while not self._closing.is_set():
            count += 1
            self.mailbox.write_heartbeat(count)
            self._deliver_traffic()
            ready, _, _ = select.select([self._event_fd], [], [], HEARTBEAT_S)
            if ready:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self._event_fd)
                with self._changed:
                    self._changed.notify_all()

    def _deliver_traffic(self) -> None:
        if self._on_traffic is None:
            return
        cycles, lost = self.mailbox.fetch_kept()
        if cycles or lost:
            self._on_traffic(cycles, lost)

    def _read_end_reason(self) -> str:
        stream = self.process.stderr
        text = stream.read(LONGEST_MESSAGE).decode(errors="replace").strip() if stream else ""
        code, self._last_words = self.process.wait(), text
        return raised_line(text) if text and code >= 0 else describe_exit(code)


def raised_line(text: str) -> str:
    """Return the line of the exception in what a program wrote before it ended, or the last line.

    Libraries may write more after the traceback.
    """
    before, found, after = text.rpartition("Traceback (most recent call last):\n")
    lines = (after if found else before or text).splitlines()
    return next((line for line in lines if not line.startswith(" ")), lines[-1]) if found else lines[-1]


def pass_traffic(sink: ByteSink, link: str) -> TrafficHandler:
    """Return a handler that passes a link's traffic on to a recorder."""

    def pass_on(cycles: list[KeptCycle], lost: int) -> None:
        sink.on_earlier_bytes(link, list(_iterate_traffic(cycles)))
        if lost:
            sink.note(link, lost_bytes=lost)

    return pass_on


def _iterate_traffic(cycles: list[KeptCycle]) -> Iterator[PassedBytes]:
    for cycle in cycles:
        yield PassedBytes(cycle.received_ns, Direction.RECEIVED, cycle.telegram)
        if cycle.reply:
            yield PassedBytes(cycle.sent_ns, Direction.SENT, cycle.reply)
