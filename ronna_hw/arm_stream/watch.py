"""Faults of a stream, latched as a driver learns of them, and raised to each caller once.

The real-time process stops the arm for what it detects itself. What only the control channel tells, and its
loss, stops the arm from here as soon as it arrives: the channel's reader calls, so that no polling is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees
from typing import Any, Generic

from ronna_hw.arm.kinematics import JointRanges
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.connections import StreamConnections
from ronna_hw.arm_stream.control_channel import S
from ronna_hw.arm_stream.records import LinkState, RecordedCycle, StopOrder
from ronna_hw.devices.lifecycle import READABLE, RUNNING, Lifecycle, LifecycleGuard
from ronna_hw.errors import RonnaError

# Safety against a controller that no longer tells its state (U).
CONTROL_SILENCE_S = 2.0  # twenty periods of the state; the control channel is not for real-time control


class StreamWatch(Generic[S]):
    """Fault monitor of one arm, and listener on its control channel; a driver adds causes of its own."""

    def __init__(self, guard: LifecycleGuard, connections: StreamConnections[S, Any], mode: str) -> None:
        """Watch a stream; `mode` is the operating mode until the first start."""
        options = connections.faults.options
        self._guard = guard
        self._connections = connections
        self._stall_limit_s = options.patience_s
        self._control_limit_s = max(CONTROL_SILENCE_S, options.silence_limit_s)
        self._raised_fault: RonnaError | None = None  # the fault that was already raised to a caller
        self.mode = mode  # in which the stream was started

    def check(self) -> None:
        """Latch any fault of the real-time process or the control channel."""
        if self._awaits_cause():
            return
        if self._guard.state not in RUNNING:
            self._check_idle()
            return
        link, control = self._connections.link, self._connections.open_control
        if (error := self._stream_error(link, link.state)) is not None:
            self._latch_with_record(self._cause_of(error), link)
        elif control is not None and control.failure is not None:
            self._stop_for(self._cause_of(control.failure))
        elif control is not None and control.silent_s > self._control_limit_s:
            faults = self._connections.faults  # an emergency stop would no longer be reported
            self._stop_for(
                faults.errors.no_answer(
                    f"{faults.name}: {control.where} is silent",
                    expected="a state every 0.1 s",
                    limit=f"{self._control_limit_s:g} s",
                )
            )

    def check_until_certain(self) -> None:
        """Latch any fault as `check` does, but wait for a cause that the driver is inquiring into."""
        self.check()

    def latch(self, error: RonnaError) -> None:
        """Latch an error that the caller is about to raise."""
        if (link := self._connections.open_link) is not None and self._guard.state in RUNNING:
            self._latch_with_record(error, link)
        self._guard.latch(error)
        self._raised_fault = self._guard.fault

    def raise_new(self) -> None:
        """Raise a latched fault that no call has raised yet."""
        self.check_until_certain()
        if (fault := self._guard.fault) is not None and fault is not self._raised_fault:
            self._raised_fault = fault
            raise fault

    def raise_any(self) -> None:
        """Raise a latched fault, if any."""
        self.check_until_certain()
        if (fault := self._guard.fault) is not None:
            self._raised_fault = fault
            raise fault

    def on_state(self, state: S) -> None:
        """Check a requested or unsolicited state; called on the channel's reader thread."""
        self.check()

    def on_silence(self) -> None:
        """Check whether the controller has been silent for too long; called on the reader thread."""
        self.check()

    def on_loss(self, failure: RonnaError) -> None:
        """Stop the arm after losing the control channel, since an emergency stop would go unreported."""
        self._stop_for(failure)

    def _awaits_cause(self) -> bool:
        """Return whether the stream has stopped just now for a cause that the controller is yet to tell."""
        return False

    def _cause_of(self, error: RonnaError) -> RonnaError:
        """Return what has led to an error that is about to be latched, as far as a driver can find out."""
        return error

    def _check_idle(self) -> None:
        state = self._guard.state
        link, control = self._connections.open_link, self._connections.open_control
        if control is not None and control.failure is not None and state in READABLE:
            self._guard.latch(self._cause_of(control.failure))
        elif link is not None and state is Lifecycle.CONFIGURED and not link.alive:
            self._guard.latch(link.death_error())

    def _stream_error(self, link: LinkClient, state: LinkState) -> RonnaError | None:
        """Return why the stream has ended, if it has."""
        faults = self._connections.faults
        error = faults.error(state, self.mode, link.surroundings, self._connections.reported)
        if error is None and not link.alive:
            error = link.death_error()
        if error is None and link.stalled_s > self._stall_limit_s:
            error = faults.errors.stalled(
                f"{faults.name}: the real-time process has not run for {link.stalled_s:.1f} s",
                limit=f"{self._stall_limit_s:g} s",
            )
        return error

    def _stop_for(self, error: RonnaError) -> None:
        if (link := self._connections.open_link) is None or self._guard.state not in RUNNING:
            return
        self._latch_with_record(error, link)
        link.stop(StopOrder.PROTECTIVE)

    def _latch_with_record(self, error: RonnaError, link: LinkClient) -> None:
        if self._guard.state is not Lifecycle.FAULT and (cycles := link.recorded_cycles()):
            faults = self._connections.faults
            title = f"{faults.name}: the last {len(cycles)} cycles before {error}"
            table = _flight_table(cycles, title, faults.arm, faults.errors.words.clock)
            error.attachments[f"flight-record-{faults.name}.txt"] = table
        self._guard.latch(error)


def _flight_table(cycles: Sequence[RecordedCycle], title: str, arm: JointRanges, clock_name: str) -> str:
    """Format cycles as a table, oldest first; times in ms before the last cycle, angles in deg."""
    angles = (f"{axis} {kind}" for kind in ("measured", "sent", "behind") for axis in arm.axis_names)
    columns = ("cycle", clock_name, "ms", "turnaround us", "choice", *angles)
    rows = [_flight_row(cycle, cycles[-1].received_ns) for cycle in cycles]
    widths = [max(len(text) for text in column) for column in zip(columns, *rows, strict=True)]
    lines = [title, ""]
    for row in (columns, *rows):
        lines.append("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))
    return "\n".join(lines) + "\n"


def _flight_row(cycle: RecordedCycle, last_ns: int) -> tuple[str, ...]:
    behind = [s - m for s, m in zip(cycle.sent_rad, cycle.measured_rad, strict=True)]
    return (
        str(cycle.cycle),
        str(cycle.device_clock),
        f"{(cycle.received_ns - last_ns) / 1e6:.2f}",
        f"{cycle.turnaround_us:.1f}",
        cycle.choice.name.lower(),
        *(f"{degrees(angle):.4f}" for angle in (*cycle.measured_rad, *cycle.sent_rad, *behind)),
    )
