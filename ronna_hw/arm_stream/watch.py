"""Faults of a stream, latched as a driver learns of them, and raised to each caller once."""

from __future__ import annotations

from typing import Protocol

from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.flight_record import attach_flight_record
from ronna_hw.arm_stream.records import NOTHING_AROUND, LinkState, StopOrder
from ronna_hw.devices.lifecycle import RUNNING, Lifecycle, LifecycleGuard
from ronna_hw.errors import RonnaError


class HasLink(Protocol):
    """Connections of an arm, among them its stream."""

    @property
    def open_link(self) -> LinkClient | None:
        """Client of the real-time process, if running."""
        ...

    @property
    def link(self) -> LinkClient:
        """Client of the real-time process; raises if it has not been started."""
        ...


class StreamWatch:
    """Fault monitor of one arm's stream. A driver adds what its other channels report."""

    def __init__(
        self, guard: LifecycleGuard, connections: HasLink, faults: StreamFaults, stall_limit_s: float
    ) -> None:
        self._faults = faults
        self._guard = guard
        self._link_of = connections
        self._stall_limit_s = stall_limit_s
        self._raised_fault: RonnaError | None = None  # the fault that was already raised to a caller

    def check(self) -> None:
        """Latch any fault of the real-time process."""
        if self._guard.state not in RUNNING:
            self._check_idle()
            return
        link = self._link_of.link
        error = self._stream_error(link, link.state)
        if error is not None:
            self._latch_with_record(error, link)

    def check_until_certain(self) -> None:
        """Latch any fault as `check` does, but wait for a cause that the driver is inquiring into."""
        self.check()

    def latch(self, error: RonnaError) -> None:
        """Latch an error that the caller is about to raise."""
        link = self._link_of.open_link
        if link is not None and self._guard.state in RUNNING:
            self._latch_with_record(error, link)
        self._guard.latch(error)
        self._raised_fault = self._guard.fault

    def raise_new(self) -> None:
        """Raise a latched fault that no call has raised yet."""
        self.check_until_certain()
        fault = self._guard.fault
        if fault is not None and fault is not self._raised_fault:
            self._raised_fault = fault
            raise fault

    def raise_any(self) -> None:
        """Raise a latched fault, if any."""
        self.check_until_certain()
        fault = self._guard.fault
        if fault is not None:
            self._raised_fault = fault
            raise fault

    def _check_idle(self) -> None:
        idle_link = self._link_of.open_link if self._guard.state is Lifecycle.CONFIGURED else None
        if idle_link is not None and not idle_link.alive:
            self._guard.latch(idle_link.death_error())

    def _stream_error(self, link: LinkClient, state: LinkState) -> RonnaError | None:
        """Return why the stream has ended, if it has."""
        error = self._state_error(state)
        if error is None and not link.alive:
            error = link.death_error()
        if error is None and link.stalled_s > self._stall_limit_s:
            error = self._faults.errors.stalled(
                f"{self._faults.name}: the real-time process has not run for {link.stalled_s:.1f} s",
                limit=f"{self._stall_limit_s:g} s",
            )
        return error

    def _state_error(self, state: LinkState) -> RonnaError | None:
        """Build the error for a fault of the real-time process, if any."""
        link = self._link_of.open_link
        return self._faults.error(state, self._mode(), NOTHING_AROUND if link is None else link.surroundings)

    def _mode(self) -> str:
        """Return the operating mode in the driver's words."""
        raise NotImplementedError

    def _stop_for(self, error: RonnaError) -> None:
        link = self._link_of.open_link
        if link is None or self._guard.state not in RUNNING:
            return
        self._latch_with_record(error, link)
        link.stop(StopOrder.PROTECTIVE)

    def _latch_with_record(self, error: RonnaError, link: LinkClient) -> None:
        if self._guard.state is not Lifecycle.FAULT:
            faults = self._faults
            attach_flight_record(
                error, faults.name, faults.arm, faults.errors.clock_name, link.recorded_cycles()
            )
        self._guard.latch(error)
