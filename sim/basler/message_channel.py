"""Camera message channel: reports events until they are acknowledged."""

from __future__ import annotations

import contextlib
import struct
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import GvcpCommand, GvcpFlag
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.settings import CameraSettings, EventKind, Ticks
from sim.basler.stream_channel import UdpChannel

STREAM_CHANNEL = 0
FRAME_NUMBER = ">I"  # additional field of ExposureEnd beyond the standard's
DEFAULT_TIMEOUT_MS, DEFAULT_RETRIES = 200, 3  # at power-on; those of the family are unconfirmed
EVENTS_KEPT = 32  # queued behind a pending message; more are lost
EVENTS_PER_MESSAGE = gev.GVCP_PAYLOAD_LIMIT // gev.EVENT_ITEM_BYTES
DATAGRAM_BYTES = 2048


@dataclass(frozen=True)
class CameraEvent:
    """A camera event, with block id 0 if it does not belong to a frame."""

    kind: EventKind
    block_id: int
    stamp_ticks: int
    data: bytes = b""

    def encode_item(self) -> bytes:
        """Encode the event as a message item."""
        head = struct.pack(gev.EVENT_ITEM, 0, self.kind, STREAM_CHANNEL, self.block_id, self.stamp_ticks)
        return head + self.data


@dataclass
class _PendingMessage:
    """A message sent but not yet acknowledged."""

    request_id: int
    datagram: bytes
    repetitions_left: int
    due_s: float


class MessageChannel(UdpChannel):
    """Message channel to one receiver, sending each message until acknowledged or out of retries.

    `now_s` is the host's monotonic clock.
    """

    def __init__(
        self,
        address: str,
        owner_address: Callable[[], str | None],
        now_s: Callable[[], float],
        faults: CameraFaults = NO_FAULTS,
    ) -> None:
        super().__init__(address, owner_address, faults)
        self.socket.setblocking(False)
        self._now_s = now_s
        self._lock = threading.Lock()
        self._waiting: deque[CameraEvent] = deque()
        self._pending: _PendingMessage | None = None
        self._request_id = 0
        self._port = 0
        self.timeout_ms = DEFAULT_TIMEOUT_MS
        self.retries = DEFAULT_RETRIES
        self.unacknowledged = 0  # messages given up
        self.changed: Callable[[], None] = lambda: None
        """Called when `due_s` may have become earlier."""

    @property
    def port(self) -> int:
        """UDP port of the receiver, or 0 while the channel is closed."""
        return self._port

    @port.setter
    def port(self, value: int) -> None:
        with self._lock:
            self._waiting.clear()
            self._pending = None
            self._port = value

    def report(self, event: CameraEvent, *, beyond_limit: bool = False) -> bool:
        """Queue an event, returning False if the queue is full; a closed channel accepts and drops it."""
        with self._lock:
            if self.receiver is None:
                return True
            if len(self._waiting) >= EVENTS_KEPT and not beyond_limit:
                return False
            self._waiting.append(event)
            if self._pending is None:
                self._send_next()
        self.changed()
        return True

    def due_s(self) -> float | None:
        """Return the host time at which to resend the pending message, or None if none is pending."""
        pending = self._pending
        return None if pending is None else pending.due_s

    def receive(self) -> None:
        """Process the received acknowledges."""
        with contextlib.suppress(OSError):
            while True:
                datagram, (host, _) = self.socket.recvfrom(DATAGRAM_BYTES)
                receiver = self.receiver
                if receiver is not None and host == receiver[0]:
                    self._handle_acknowledge(datagram)

    def repeat_overdue(self) -> None:
        """Resend the pending message if its acknowledge is overdue, giving up after the last retry."""
        with self._lock:
            pending = self._pending
            if pending is None or self._now_s() < pending.due_s:
                return
            if not pending.repetitions_left:
                self.unacknowledged += 1
                self._pending = None
                self._send_next()
                return
            pending.repetitions_left -= 1
            pending.due_s = self._now_s() + self.timeout_ms / 1e3
            self._transmit(pending.datagram)

    def shut(self) -> None:
        """Close the channel and drop its queued events."""
        self.port = 0

    def _handle_acknowledge(self, datagram: bytes) -> None:
        if len(datagram) < gev.GVCP_HEADER_BYTES:
            return
        _, code, _, request_id = struct.unpack_from(gev.GVCP_ACK_HEADER, datagram)
        with self._lock:
            pending = self._pending
            accepted_codes = (GvcpCommand.EVENT_ACK, GvcpCommand.EVENTDATA_ACK)
            if pending is not None and code in accepted_codes and request_id == pending.request_id:
                self._pending = None
                self._send_next()

    def _send_next(self) -> None:
        """Send the next message, combining queued events unless they carry data."""
        while self._waiting and self._pending is None:
            together = [self._waiting.popleft()]
            while (
                not together[0].data
                and self._waiting
                and not self._waiting[0].data
                and len(together) < EVENTS_PER_MESSAGE
            ):
                together.append(self._waiting.popleft())
            self._send(together)

    def _send(self, events: list[CameraEvent]) -> None:
        self._request_id = self._request_id % gev.REQUEST_ID_LAST + gev.REQUEST_ID_FIRST
        command = GvcpCommand.EVENTDATA if events[0].data else GvcpCommand.EVENT
        payload = b"".join(event.encode_item() for event in events)
        flags = GvcpFlag.ACK_REQUIRED if self.timeout_ms else GvcpFlag(0)
        head = struct.pack(
            gev.GVCP_COMMAND_HEADER, gev.GVCP_KEY, flags, command, len(payload), self._request_id
        )
        if self.timeout_ms:
            due_s = self._now_s() + self.timeout_ms / 1e3
            self._pending = _PendingMessage(self._request_id, head + payload, self.retries, due_s)
        self._transmit(head + payload)

    def _transmit(self, datagram: bytes) -> None:
        receiver = self.receiver
        lost = self._faults.draw_message_loss() or not self._faults.passes(
            len(datagram) + gev.IP_UDP_HEADER_BYTES
        )
        if receiver is not None and not lost:
            with contextlib.suppress(OSError):  # a receiver that is gone
                self.socket.sendto(datagram, receiver)


class EventReporter:
    """Thread-safe reporter of one camera's events, limited to those with notification enabled."""

    def __init__(self, settings: Callable[[], CameraSettings], channel: MessageChannel, ticks: Ticks) -> None:
        self._settings = settings
        self._channel = channel
        self._ticks = ticks
        self._overrun_reported = False

    def report(self, kind: EventKind, block_id: int, moment_ns: int) -> None:
        """Report an event at a theatre time in ns if its notification is enabled."""
        if kind not in self._settings().events_notified or self._channel.receiver is None:
            return
        data = struct.pack(FRAME_NUMBER, block_id) if kind is EventKind.EXPOSURE_END else b""
        ticks = self._ticks.count(moment_ns)
        if self._channel.report(CameraEvent(kind, block_id, ticks, data)):
            self._overrun_reported = False
        elif EventKind.EVENT_OVERRUN in self._settings().events_notified and not self._overrun_reported:
            # one warning while the queue stays full; the number of lost events is not reported
            self._overrun_reported = True
            self._channel.report(CameraEvent(EventKind.EVENT_OVERRUN, 0, ticks), beyond_limit=True)
