"""Causes of a stop that only EKI tells: emergency stop, guard, mode, drives, messages."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import NamedTuple

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import ControllerState, unmet_conditions
from drivers.kuka_rsi.errors import CONTROLLER_STOPPED
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import LinkFault, LinkState
from ronna_hw.arm_stream.watch import StreamWatch
from ronna_hw.devices.lifecycle import RUNNING, LifecycleGuard
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import OperationMode

# Safety against an arm that does not follow, for a reason not told (U).
CAUSE_S = 1.0  # host time for the controller's cause when axes no longer follow; they are already stopping


class _Inquiry(NamedTuple):
    """Pending request for the controller state, with its host time limit."""

    eki: EkiClient
    number: int
    until_s: float

    @property
    def reply(self) -> ControllerState | None:
        """State sent in reply, if it has arrived."""
        return self.eki.find_reply(self.number)


class FaultWatch(StreamWatch[ControllerState]):
    """Fault monitor for one arm, and listener on its EKI connection."""

    mode: OperationMode  # a change stops the arm

    def __init__(self, guard: LifecycleGuard, connections: Connections) -> None:
        super().__init__(guard, connections, OperationMode.EXT)
        self._inquiry: _Inquiry | None = None  # why the axes no longer follow
        self._inquiry_lock = threading.Lock()

    def check_until_certain(self) -> None:
        """Latch any fault as `check` does, but wait for the controller's cause of a following error."""
        self.check()
        if (inquiry := self._inquiry) is not None:
            with contextlib.suppress(RonnaError):  # with a broken channel the following error is latched
                inquiry.eki.await_reply(inquiry.number, max(0.0, inquiry.until_s - time.monotonic()))
            self.check()

    def on_state(self, state: ControllerState) -> None:
        """Check a requested or unsolicited controller state; called on the EKI reader thread."""
        self.check()
        if (stop_error := self._controller_stop_error(state)) is not None:
            self._stop_for(stop_error)

    def on_loss(self, failure: RonnaError) -> None:
        """Stop the arm after losing EKI, unless the stream has stopped for another reason."""
        with contextlib.suppress(Exception):  # perhaps the reader's own failure: the arm is stopped
            self.check()
        self._stop_for(failure)

    def _controller_stop_error(self, state: ControllerState) -> RonnaError | None:
        if not (causes := unmet_conditions(state, drives=True, modes=(self.mode,))):
            return None
        link = self._connections.open_link
        if state.error and link is not None and (count := link.state.foreign):
            # A stranger that opened the stream is answered in the controller's place, which then times out.
            telegrams = f"{count} telegram{'s' * (count > 1)}"
            causes.append(
                f"note: {telegrams} came from another sender, the last from {link.state.foreign_host}"
            )
        return CONTROLLER_STOPPED(f"{self._connections.faults.name} was stopped: {'; '.join(causes)}")

    def _awaits_cause(self) -> bool:
        """Return whether axes no longer follow, and the controller is yet to tell why.

        Braked axes leave their set-points before the controller's unsolicited state arrives: only its reply
        to a later request counts.
        """
        eki = self._connections.open_control
        if self._guard.state not in RUNNING or not _is_lagging(self._connections.link.state):
            self._inquiry = None
            return False
        with self._inquiry_lock:
            inquiry = self._inquiry
            if eki is None or eki.failure is not None:
                inquiry = None
            elif inquiry is None or inquiry.eki is not eki:
                try:
                    inquiry = _Inquiry(eki, eki.request_state(), time.monotonic() + CAUSE_S)
                except RonnaError:
                    inquiry = None
            self._inquiry = inquiry
        return inquiry is not None and inquiry.reply is None and time.monotonic() <= inquiry.until_s

    def _stream_error(self, link: LinkClient, state: LinkState) -> RonnaError | None:
        error, inquiry = super()._stream_error(link, state), self._inquiry
        told = None if error is None or inquiry is None else inquiry.reply
        return error if told is None else self._controller_stop_error(told) or error

    def _latch_with_record(self, error: RonnaError, link: LinkClient) -> None:
        super()._latch_with_record(error, link)
        self._inquiry = None  # last: a thread that sees no inquiry then sees the fault


def _is_lagging(state: LinkState) -> bool:
    return state.fault is LinkFault.MONITOR and state.violation_kind == ViolationKind.FOLLOWING_ERROR
