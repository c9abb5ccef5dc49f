"""Exchange of RSI telegrams: receive and answer those of the stream's controller, count all others."""

from __future__ import annotations

import socket
import time

from drivers.kuka_rsi.realtime.session import DelayAndIpoc, RsiSession
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.sockets import Address, LinkSockets, Received, Rehearsal
from drivers.kuka_rsi.realtime.telegram import Found, TelegramReader, extract_telegram, read_strictly
from ronna_hw.arm_stream.errors import MalformedMessage
from ronna_hw.arm_stream.loop import StreamLoop
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.records import StreamPhase
from ronna_hw.arm_stream.session import STREAMING_PHASES, PreparedReply

BUNCH_S = 200e-6  # in which telegrams that were delayed together arrive
FOREIGN_AT_ONCE = 8  # taken at each look: a flood on the port must not delay the reply


class LinkLoop(StreamLoop):
    """Main loop of the real-time process; ends once the parent has exited and the arm is at rest."""

    session: RsiSession

    def __init__(
        self,
        settings: LinkSettings,
        link: socket.socket,
        mailbox: Mailbox,
        *,
        real_time: bool = False,
        locked: bool = False,
    ) -> None:
        self._sockets = LinkSockets(link)
        super().__init__(
            RsiSession(settings),
            settings,
            self._sockets,
            mailbox,
            settings.cycle_ms / 1000.0,
            real_time=real_time,
            locked=locked,
        )
        self._reader = TelegramReader(settings.send_tags)
        self._rehearsal = Rehearsal()
        self._controller_host = settings.controller_host
        self._last_data = b""  # the last telegram answered
        self._peer: Address | None = None

    def _step(self) -> None:
        if (received := self._receive()) is None:
            self._check_orders()
        else:
            self._serve(*received)

    def close(self) -> None:
        """Close the sockets of the loop."""
        self._sockets.disconnect()
        self._rehearsal.close()

    def _receive(self) -> Received | None:
        """Return the controller's newest telegram, or None if none arrives in time."""
        if self._peer is not None and self.session.phase not in STREAMING_PHASES:
            self._end_stream()
        received: Received | None = self._receiver.next()
        if received is None:
            return None
        self._received_ns = self._receiver.received_ns
        # The usual sender first: a call costs as much as reading a telegram.
        newest = None if received[1] != self._peer and self._is_foreign(received[1]) else received
        # Delayed telegrams arrive in a burst: only the last one is worth an answer.
        is_late = self._received_ns - self._answered_ns >= self._late_ns
        if is_late:
            time.sleep(BUNCH_S)
        # Before a stream, anyone's may be the newest: each is checked.
        if (is_late or self._receiver.was_queued) and self.session.phase is not StreamPhase.ARMED:
            newest = self._drain(newest)
        return newest

    def _drain(self, newest: Received | None) -> Received | None:
        try:
            while self._sockets.has_datagram():
                received = self._sockets.receive(socket.MSG_DONTWAIT)
                if not self._is_foreign(received[1]):
                    self.session.dropped += newest is not None
                    newest = received
        except OSError:
            pass
        return newest

    def _begin_stream(self, peer: Address) -> None:
        """Adopt the sender of the first telegram as the stream's peer."""
        self._mailbox.clear_histograms()
        self._peer = peer
        self._sockets.connect_to(peer)

    def _end_stream(self) -> None:
        """Release the stream's peer, because the next stream may come from another port."""
        self._look_aside()
        self._peer = None
        self._sockets.disconnect()
        self._processor.free()

    def _look_aside(self) -> None:
        """Count foreign senders."""
        for _ in range(FOREIGN_AT_ONCE):
            if (address := self._sockets.foreign_sender()) is None:
                return
            if address != self._peer:  # the controller's own may still be queued from before the stream
                self.session.senders.count_foreign(address[0])

    def _is_foreign(self, address: Address) -> bool:
        session = self.session
        if session.phase in STREAMING_PHASES:
            is_from_stranger = address != self._peer
        else:
            is_from_stranger = bool(self._controller_host) and address[0] != self._controller_host
        if is_from_stranger:
            session.senders.count_foreign(address[0])
        return is_from_stranger

    def _serve(self, data: bytes, address: Address) -> None:
        session = self.session
        found, ready = self._match(data)
        if found is not None and ready is not None:
            self._send(ready.reply, address)
            self._last_data = data
            orders, telegram = self._mailbox.orders(), extract_telegram(found)
            session.advance_after_reply(telegram, orders, self._received_ns)
            self._finish_cycle(data, session.device_clock, orders)
            return
        orders = self._mailbox.orders()
        try:
            telegram = extract_telegram(found) if found is not None else read_strictly(data)
        except MalformedMessage:
            session.rejected += 1
            if session.phase is StreamPhase.ARMED:
                session.senders.host = address[0]
            self._leave_unanswered(data)
            return
        if session.phase is StreamPhase.ARMED:
            if not session.is_expected(telegram):
                session.senders.host = address[0]
                self._leave_unanswered(data)
                return
            self._begin_stream(address)
        if (reply := session.answer(telegram, orders, self._received_ns)) is None:
            self._leave_unanswered(data)
            return
        self._send(reply, address)
        self._finish_cycle(data, session.device_clock, orders)

    def _match(self, data: bytes) -> tuple[Found | None, PreparedReply[DelayAndIpoc] | None]:
        """Match a telegram against the fast parser and the prepared reply."""
        found = self._reader.match(data)
        return found, found and self.session.match(found, self._mailbox.stop_word())

    def _rehearse(self) -> None:
        """Run the code path from telegram to reply without effect, to keep the caches warm."""
        self._rehearsal.exchange(self._last_data)
        self._match(self._last_data)

    def _send(self, reply: bytes, address: Address) -> None:
        try:
            self._sockets.send(reply, address)
        except OSError:
            self.session.rejected += 1
        self._note_sent(reply)
