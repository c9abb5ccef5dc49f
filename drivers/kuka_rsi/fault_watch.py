"""Fault detection for the real-time process, the EKI channel and the controller.

The real-time process stops the arm for faults that it detects itself. Faults that only EKI reports (emergency
stop, guard, mode, drives, a message, or a broken channel) stop the arm from here as soon as they arrive. The
reader of that channel also calls this while nothing arrives, so that no polling is needed.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import NamedTuple

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import ControllerState, unmet_conditions
from drivers.kuka_rsi.errors import ControllerStopped, NoAnswer
from drivers.kuka_rsi.fault_errors import fault_error, stream_faults
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import NOTHING_AROUND, Fault, LinkState
from ronna_hw.arm_stream.watch import StreamWatch
from ronna_hw.devices.lifecycle import READABLE, RUNNING, LifecycleGuard
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import OperationMode

REASON_S = 1.0  # host time for the controller's reason when axes no longer follow; they are already stopping
EKI_SILENCE_S = 2.0  # twenty periods of the unsolicited state; EKI is not for real-time control


class _Inquiry(NamedTuple):
    """Pending request for the controller state, with its host time limit."""

    eki: EkiClient
    number: int
    until_s: float


class FaultWatch(StreamWatch):
    """Fault monitor for one arm, and listener on its EKI connection."""

    def __init__(
        self, name: str, guard: LifecycleGuard, connections: Connections, options: KukaOptions
    ) -> None:
        # The same patience as that process has with this program and with the controller.
        stall_limit_s = max(options.heartbeat_limit_s, options.silence_limit_s)
        super().__init__(guard, connections, stream_faults(name, options), stall_limit_s)
        self._name = name
        self._connections = connections
        self._options = options
        self._eki_limit_s = max(EKI_SILENCE_S, options.silence_limit_s)
        self._inquiry: _Inquiry | None = None  # why the axes no longer follow
        self._inquiry_lock = threading.Lock()
        self.mode = OperationMode.EXT  # mode in which the stream was started: a change stops the arm

    def check(self) -> None:
        """Latch any fault of the real-time process or the EKI channel."""
        if self._guard.state not in RUNNING:
            self._check_idle()
            return
        eki, link = self._connections.open_eki, self._connections.link
        state = link.state
        error = self._state_error(state)
        is_lagging = state.fault is Fault.MONITOR and state.violation_kind == ViolationKind.FOLLOWING_ERROR
        if error is not None and is_lagging and eki is not None and eki.failure is None:
            error = self._find_following_error_cause(error, eki)
            if error is None:
                return
        else:
            self._inquiry = None
            error = self._stream_error(link, state)
        if error is not None:
            self._latch_with_record(error, link)
        elif eki is not None and eki.failure is not None:
            self._stop_for(eki.failure)
        elif eki is not None and eki.silent_s > self._eki_limit_s:
            # An emergency stop would no longer be reported.
            where = f"{self._name}: {eki.where} is silent"
            self._stop_for(NoAnswer(where, expected="a State every 0.1 s", limit=f"{self._eki_limit_s:g} s"))

    def check_until_certain(self) -> None:
        """Latch any fault as `check` does, but wait for the controller's reason for a following error."""
        self.check()
        eki, inquiry = self._connections.open_eki, self._inquiry
        if eki is not None and inquiry is not None:
            with contextlib.suppress(RonnaError):  # with a broken channel the following error is latched
                eki.await_reply(inquiry.number, max(0.0, inquiry.until_s - time.monotonic()))
            self.check()

    def on_state(self, state: ControllerState) -> None:
        """Check a requested or unsolicited controller state; called on the EKI reader thread."""
        self.check()
        if self._guard.state not in RUNNING:
            return
        stop_error = self._controller_stop_error(state)
        if stop_error is not None:
            self._stop_for(stop_error)

    def on_silence(self) -> None:
        """Check whether the controller has been silent for too long; called on the EKI reader thread."""
        self.check()

    def on_loss(self, failure: RonnaError) -> None:
        """Stop the arm after losing EKI, since an emergency stop would go unreported."""
        if self._guard.state in RUNNING:
            with contextlib.suppress(Exception):  # perhaps the reader's own failure: the arm is stopped
                self.check()
            self._stop_for(failure)

    def _controller_stop_error(self, state: ControllerState) -> ControllerStopped | None:
        causes = unmet_conditions(state, drives=True, modes=(self.mode,))
        if not causes:
            return None
        link = self._connections.open_link
        if state.error and link is not None and (count := link.state.foreign):
            # A stranger that opened the stream is answered in the controller's place, which then times out.
            telegrams = f"{count} telegram{'s' * (count > 1)}"
            causes.append(
                f"note: {telegrams} came from another sender, the last from {link.state.foreign_host}"
            )
        return ControllerStopped(f"{self._name} was stopped: {'; '.join(causes)}")

    def _find_following_error_cause(self, tripped: RonnaError, eki: EkiClient) -> RonnaError | None:
        """Return the controller's reason for a following error, otherwise `tripped`; None while unknown.

        Braked axes leave their set-points before the controller's unsolicited state arrives: only its reply
        to a later request counts.
        """
        with self._inquiry_lock:
            inquiry = self._inquiry
            if inquiry is None or inquiry.eki is not eki:
                try:
                    inquiry = self._inquiry = _Inquiry(eki, eki.request_state(), time.monotonic() + REASON_S)
                except RonnaError:
                    return tripped
        state = eki.find_reply(inquiry.number)
        if state is not None:
            return self._controller_stop_error(state) or tripped
        return tripped if time.monotonic() > inquiry.until_s else None

    def _check_idle(self) -> None:
        eki = self._connections.open_eki
        if eki is not None and eki.failure and self._guard.state in READABLE:
            self._guard.latch(eki.failure)
        else:
            super()._check_idle()

    def _latch_with_record(self, error: RonnaError, link: LinkClient) -> None:
        super()._latch_with_record(error, link)
        self._inquiry = None  # last: a thread that sees no inquiry then sees the fault

    def _state_error(self, state: LinkState) -> RonnaError | None:
        eki = self._connections.open_eki
        latest = eki.latest if eki is not None else None
        message = latest.error if latest is not None else 0
        link = self._connections.open_link
        arm_surroundings = NOTHING_AROUND if link is None else link.surroundings
        return fault_error(self._name, state, self._options, self.mode, message, arm_surroundings)
