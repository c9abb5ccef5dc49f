"""Connections of an arm that is driven by a stream: real-time process and control channel."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from ronna_hw.arm_stream.client import LinkClient, TrafficHandler, pass_traffic
from ronna_hw.arm_stream.control_channel import AnyChannel, BytesPassed, Listener, S
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.records import CloseStream, EndStream, LinkFault, StreamPhase
from ronna_hw.clock import Clock
from ronna_hw.devices.capabilities import ByteSink
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import RonnaError, is_error

FIRST_PAUSE_S = 0.1  # between attempts to reopen the connections; doubled each time
LONGEST_PAUSE_S = 2.0
SHORTEST_TRY_S = 0.2
END_LIMIT_S = 1.0  # host time for the controller's program to end on an order in the stream
C = TypeVar("C", bound=AnyChannel)


class StreamConnections(ABC, Generic[S, C]):
    """Connections of one arm; accessing a closed one raises. A driver opens them, and adds its own."""

    def __init__(self, faults: StreamFaults, clock: Clock) -> None:
        self.faults = faults  # replaced once the individual arm is known
        self.clock = clock
        self.open_control: C | None = None
        self.open_link: LinkClient | None = None
        self.recorder: ByteSink | None = None  # takes effect when a connection is opened

    @abstractmethod
    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process."""

    @abstractmethod
    def request_state(self, timeout_s: float) -> S:
        """Return a state that the controller has reported after this call."""

    @abstractmethod
    def acknowledge(self, person: str, deadline: float) -> None:
        """End any program, acknowledge what has to be acknowledged, and raise what remains; moves nothing."""

    @abstractmethod
    def _identify(self, timeout_s: float) -> Identity:
        """Open the control channel and identify arm and controller; what is open is closed on an error."""

    @abstractmethod
    def _ask(self, timeout_s: float) -> None:
        """Ask the controller anything; raises if it does not answer."""

    @abstractmethod
    def _await_program_end(self, timeout_s: float) -> bool:
        """Wait until the controller's program has ended on the order in the stream."""

    @abstractmethod
    def _end_program(self, timeout_s: float) -> None:
        """End the controller's program by command."""

    @property
    def reported(self) -> S | None:
        """Controller state received last, requested or unsolicited."""
        latest: S | None = None if self.open_control is None else self.open_control.latest
        return latest

    @property
    def control(self) -> C:
        """Open control channel; raises the driver's error if not connected."""
        if self.open_control is None:
            raise self.faults.errors.not_found(f"{self.faults.name}: no connection to the controller is open")
        return self.open_control

    @property
    def link(self) -> LinkClient:
        """Client of the real-time process; raises the driver's error if it has not been started."""
        if self.open_link is None:
            raise self.faults.errors.not_started(f"{self.faults.name}: no real-time process is running")
        return self.open_link

    def is_answering(self, limit_s: float) -> bool:
        """Return whether the controller still answers on the open connections in time."""
        if self.open_control is None or self.open_control.failure is not None:
            return False
        try:
            self._ask(limit_s)
        except RonnaError:
            return False
        return True

    def find_controller(self, timeout_s: float, listener: Listener[S], *, retry: bool = False) -> Identity:
        """Open the control channel, and identify arm and controller.

        With `retry`, try until the time limit at growing pauses: after a loss the controller's server must
        first reopen. Raises the driver's errors: nothing answers, another arm, another set-up.
        """
        self.close_control()
        errors = self.faults.errors
        deadline, pause_s = time.monotonic() + timeout_s, FIRST_PAUSE_S
        limit_s = max(timeout_s, SHORTEST_TRY_S) if retry else timeout_s
        while True:
            try:
                identity = self._identify(limit_s)
                break
            except RonnaError as error:
                self.close_control()
                may_return = retry and is_error(error, errors.not_found, errors.lost)
                if not may_return or remaining_s(deadline) <= pause_s:
                    raise
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            limit_s = max(remaining_s(deadline), SHORTEST_TRY_S)
        self.control.listen(listener)
        return identity

    def end_stream(self, deadline: float) -> None:
        """End the controller's program by an order in the stream, or by command, and close the stream."""
        link = self.link
        number = link.command(EndStream())
        state = link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        can_end = (
            state is not None and state.phase is StreamPhase.ENDING and state.fault is not LinkFault.SILENCE
        )
        if not (can_end and self._await_program_end(min(remaining_s(deadline) / 2, END_LIMIT_S))):
            self._end_program(max(remaining_s(deadline), SHORTEST_TRY_S))
        number = link.command(CloseStream())
        link.wait(lambda s: s.command_number >= number, remaining_s(deadline))

    def close_control(self) -> None:
        """Close the control channel, if open."""
        if self.open_control is not None:
            self.open_control.close()
            self.open_control = None

    def close_link(self) -> None:
        """Stop the real-time process, if running."""
        if self.open_link is not None:
            self.open_link.close()
            self.open_link = None

    def _bytes_of(self, interface: str) -> BytesPassed | None:
        """Return what takes the bytes of an interface, or None without a recorder."""
        sink, name = self.recorder, f"{self.faults.name}.{interface}"
        return None if sink is None else lambda direction, data: sink.on_bytes(name, direction, data)

    def _traffic_of(self, interface: str) -> TrafficHandler | None:
        """Return what takes the traffic of the stream, or None without a recorder."""
        sink, name = self.recorder, f"{self.faults.name}.{interface}"
        return None if sink is None else pass_traffic(sink, name)


def remaining_s(deadline: float) -> float:
    """Return the time remaining until a deadline on the host's monotonic clock, at least 0."""
    return max(deadline - time.monotonic(), 0.0)
