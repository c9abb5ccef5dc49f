"""Main loop of the real-time process: receive, answer, prepare the next reply.

The controller sends first and clocks everything. Nothing is computed between receiving and sending that could
have been computed before; after a stall only the newest telegram in the queue is answered. Telegrams from
anyone but the stream's controller are counted and otherwise ignored.

This process has priority over all others. The network's soft interrupt, which may transmit the reply on this
processor, would have to wait until the next set-point is prepared. While the controller keeps a pace, the
processor is therefore yielded for a moment once the reply is out. Otherwise a peer on this machine would see
the preparation, 60 us and more, as turnaround.
"""

from __future__ import annotations

import os
import socket
import time

from drivers.kuka_rsi.errors import BadTelegram
from drivers.kuka_rsi.realtime.link_health import histogram_bin
from drivers.kuka_rsi.realtime.link_state import Command, LinkSettings, Orders, Phase, RecordedCycle
from drivers.kuka_rsi.realtime.mailbox import Mailbox
from drivers.kuka_rsi.realtime.responder import STREAMING_PHASES, Responder
from drivers.kuka_rsi.realtime.set_points import PreparedReply
from drivers.kuka_rsi.realtime.sockets import Address, LinkSockets, Received, Rehearsal, TelegramReceiver
from drivers.kuka_rsi.realtime.telegram import (
    REPLY_TAIL,
    Found,
    TelegramReader,
    extract_telegram,
    read_strictly,
)
from ronna_hw.host.real_time import ProcessorAffinity

# Without the parent and without a telegram for this long, there is no one left to answer.
QUIET_AFTER_STOP_NS = 100_000_000  # the program was asked to end
QUIET_BEFORE_STOP_NS = 400_000_000  # the usual Timeout of a controller: a loaded computer stalls for less
LONGEST_ENDING_CYCLES = 250  # of sending Stop after the parent is gone
BUNCH_S = 200e-6  # in which telegrams that were delayed together arrive
YIELD_S = 50e-6  # of processor time after a reply; a cycle has 4,000
RECORDED_AFTER_FAULT = 64  # cycles: how the stop began
FOREIGN_AT_ONCE = 8  # taken at each look: a flood on the port must not delay the reply
LATE_CYCLES = 1.5  # waited this many cycles for a telegram: the host, or the network, was delayed
LOOK_EACH_CYCLES = 32  # of lock-step, for the processor of the sender and for foreign senders
PACED_SHARE = 0.2  # of a cycle between two telegrams: the controller keeps a pace, and there is time


class LinkLoop:
    """Main loop of the real-time process; ends once the parent has exited and the arm is at rest."""

    def __init__(
        self,
        settings: LinkSettings,
        link: socket.socket,
        mailbox: Mailbox,
        *,
        real_time: bool = False,
        locked: bool = False,
    ) -> None:
        self.responder = Responder(settings)
        self._reader = TelegramReader(settings.send_tags)
        self._sockets = LinkSockets(link)
        self._receiver = TelegramReceiver(
            self._sockets, lead_ns=settings.rehearsal_lead_us * 1000, rehearse=self._rehearse
        )
        self._rehearsal = Rehearsal()
        self._processor = ProcessorAffinity(follows=real_time)
        self._mailbox = mailbox
        self._event_fd = settings.event_fd
        self._granted = (real_time, locked)
        self._controller_host = settings.controller_host
        self._keeps_bytes = settings.keeps_bytes
        self._received_ns = 0  # arrival of the last telegram
        self._last_data = b""  # the last telegram answered
        self._last_reply = b""
        self._sent_ns = 0
        self._late_ns = round(LATE_CYCLES * settings.cycle_ms * 1e6)
        self._answered_ns = 0  # arrival of the last telegram answered
        self._paced_ns = round(PACED_SHARE * settings.cycle_ms * 1e6)
        self._turnaround_us = 0.0  # until its reply was sent
        self._peer: Address | None = None
        self._command_number = 0
        self._published: tuple[object, ...] = ()
        self._ending_cycles = 0
        self._stop_sent = False  # in the last reply
        self._lock_step_cycles = 0  # without a pause
        self._cycles_since_fault = 0

    def run(self) -> None:
        """Run until the parent has exited and the arm is at rest."""
        self._publish()
        while not self._is_done():
            received = self._receive()
            if received is None:
                self._check_orders()
            else:
                self._serve(*received)

    def close(self) -> None:
        """Close the sockets opened by the loop."""
        self._sockets.disconnect()
        self._rehearsal.close()

    def _receive(self) -> Received | None:
        """Return the controller's newest telegram, or None if none arrives in time."""
        if self._peer is not None and self.responder.phase not in STREAMING_PHASES:
            self._end_stream()
        received = self._receiver.next()
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
        if (is_late or self._receiver.was_queued) and self.responder.phase is not Phase.ARMED:
            newest = self._drain(newest)
        return newest

    def _drain(self, newest: Received | None) -> Received | None:
        try:
            while self._sockets.has_datagram():
                received = self._sockets.receive(socket.MSG_DONTWAIT)
                if not self._is_foreign(received[1]):
                    self.responder.dropped += newest is not None
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
        self._count_foreign_senders()
        self._peer = None
        self._sockets.disconnect()
        self._processor.free()

    def _count_foreign_senders(self) -> None:
        for _ in range(FOREIGN_AT_ONCE):
            address = self._sockets.foreign_sender()
            if address is None:
                return
            if address != self._peer:  # the controller's own may still be queued from before the stream
                self.responder.senders.count_foreign(address[0])

    def _is_foreign(self, address: Address) -> bool:
        responder = self.responder
        if responder.phase in STREAMING_PHASES:
            is_from_stranger = address != self._peer
        else:
            is_from_stranger = bool(self._controller_host) and address[0] != self._controller_host
        if is_from_stranger:
            responder.senders.count_foreign(address[0])
        return is_from_stranger

    def _serve(self, data: bytes, address: Address) -> None:
        responder = self.responder
        found, ready = self._match_prepared_reply(data)
        if found is not None and ready is not None:
            self._send(ready.reply, address)
            self._last_data = data
            orders, telegram = self._mailbox.orders(), extract_telegram(found)
            responder.note_answered(telegram, orders, self._received_ns)
            self._finish_cycle(data, telegram.ipoc, orders)
            return
        orders = self._mailbox.orders()
        try:
            telegram = extract_telegram(found) if found is not None else read_strictly(data)
        except BadTelegram:
            responder.rejected += 1
            if responder.phase is Phase.ARMED:
                responder.senders.host = address[0]
            self._leave_unanswered(data)
            return
        if responder.phase is Phase.ARMED:
            if not responder.is_expected(telegram):
                responder.senders.host = address[0]
                self._leave_unanswered(data)
                return
            self._begin_stream(address)
        head = responder.answer(telegram, orders, self._received_ns)
        if head is None:
            self._leave_unanswered(data)
            return
        self._send(head + telegram.ipoc + REPLY_TAIL, address)
        self._finish_cycle(data, telegram.ipoc, orders)

    def _match_prepared_reply(self, data: bytes) -> tuple[Found | None, PreparedReply | None]:
        """Match a telegram against the fast parser and the prepared reply."""
        found, ready = self._reader.match(data), self.responder.ready
        if (
            ready is None
            or found is None
            or found.group("D", "IPOC") != ready.delay_and_ipoc
            or self._mailbox.stop_word() != ready.stop_word
        ):
            return found, None
        return found, ready

    def _rehearse(self) -> None:
        """Run the code path from telegram to reply without effect, to keep the caches warm."""
        self._rehearsal.exchange(self._last_data)
        self._match_prepared_reply(self._last_data)

    def _send(self, reply: bytes, address: Address) -> None:
        try:
            self._sockets.send(reply, address)
        except OSError:
            self.responder.rejected += 1
        self._sent_ns = sent_ns = time.monotonic_ns()
        self._last_reply = reply
        if self._received_ns - self._answered_ns > self._paced_ns:
            self._lock_step_cycles = 0
            if self._receiver.note_paced():
                time.sleep(YIELD_S)
                self._processor.follow(self._sockets.processor())
        else:
            self._receiver.note_lock_step()
            self._lock_step_cycles += 1
            if self._is_time_to_look():
                self._processor.avoid(self._sockets.processor())
        self._answered_ns = self._received_ns
        self._turnaround_us = (sent_ns - self._received_ns) / 1000.0

    def _is_time_to_look(self) -> bool:
        """Return whether system calls that lock-step needs only now and then are due; in a pace always."""
        return not self._lock_step_cycles or self._lock_step_cycles % LOOK_EACH_CYCLES == 1

    def _finish_cycle(self, data: bytes, ipoc: bytes, orders: Orders) -> None:
        """Prepare the next reply and record the completed cycle."""
        responder, mailbox = self.responder, self._mailbox
        self._stop_sent = responder.phase is Phase.ENDING
        responder.finish_cycle(self._new_command(orders.command_number))
        mailbox.count_turnaround(histogram_bin(self._turnaround_us))
        mailbox.count_jitter(histogram_bin(responder.jitter_us))
        self._cycles_since_fault = self._cycles_since_fault + 1 if responder.fault else 0
        if self._cycles_since_fault <= RECORDED_AFTER_FAULT:
            mailbox.record(
                RecordedCycle(
                    responder.cycles,
                    int(ipoc),
                    self._received_ns,
                    self._turnaround_us,
                    responder.measured_rad,
                    responder.sent_rad,
                    responder.choice,
                )
            )
        if self._keeps_bytes:
            mailbox.keep(self._received_ns, self._sent_ns, data, self._last_reply)
        if self._is_time_to_look():
            self._count_foreign_senders()
        self._publish()

    def _leave_unanswered(self, data: bytes) -> None:
        if self._keeps_bytes:
            self._mailbox.keep(self._received_ns, 0, data, b"")
        self._check_orders()

    def _check_orders(self) -> None:
        self._count_foreign_senders()
        orders = self._mailbox.orders()
        self.responder.monitor_silence(orders, time.monotonic_ns())
        command = self._new_command(orders.command_number)
        if command is not None:
            self.responder.execute_command(command)
        self._publish()

    def _new_command(self, number: int) -> Command | None:
        """Return the latest command if complete and not seen yet."""
        if number == self._command_number:
            return None
        command = self._mailbox.read_command()
        if command is None or command.number != number:
            return None
        self._command_number = number
        return command

    def _publish(self) -> None:
        real_time, locked = self._granted
        state = self.responder.state(real_time=real_time, locked=locked)
        self._mailbox.write_state(state)
        self._mailbox.write_alive(time.monotonic_ns())
        published = (
            state.phase,
            state.fault,
            state.result,
            state.settled,
            state.command_number,
            state.stop_number,
        )
        if published != self._published:
            self._published = published
            os.eventfd_write(self._event_fd, 1)

    def _is_done(self) -> bool:
        responder = self.responder
        if not responder.is_parent_gone:
            return False
        if responder.phase not in STREAMING_PHASES:
            return True
        if responder.phase is Phase.ENDING:
            self._ending_cycles += 1
        quiet_ns = QUIET_AFTER_STOP_NS if self._stop_sent else QUIET_BEFORE_STOP_NS
        return (
            self._ending_cycles > LONGEST_ENDING_CYCLES
            or responder.silent_for_ns(time.monotonic_ns()) > quiet_ns
        )
