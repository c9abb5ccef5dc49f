"""The loop of the real-time process: receive, answer, then prepare the next answer.

The controller sends first and clocks everything. Between receiving and sending nothing is computed that could
have been computed before; after a stall only the newest telegram in the queue is answered.
"""

from __future__ import annotations

import os
import socket
import struct
import time

from drivers.kuka_rsi.errors import BadTelegram
from drivers.kuka_rsi.mailbox import Command, Mailbox, Phase, Record
from drivers.kuka_rsi.session import Session
from drivers.kuka_rsi.settings import LinkSettings
from drivers.kuka_rsi.telegram import LONGEST_TELEGRAM, REPLY_TAIL, TelegramReader
from drivers.kuka_rsi.turnaround import bin_of

IDLE_LOOK_S = 0.01  # how long to wait for a telegram before looking at orders, silence and parent
QUIET_AFTER_PARENT_NS = 100_000_000  # no telegram for so long: nobody is left to answer
LONGEST_ENDING_CYCLES = 250  # of Stop being sent after the parent is gone
_TIMEVAL = struct.Struct("ll")

Address = tuple[str, int]


def bind(host: str, port: int) -> socket.socket:
    """The socket that the controller sends to. No address reuse: a second listener would take telegrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.bind((host, port))
    except OSError:
        link.close()
        raise
    seconds, rest = divmod(IDLE_LOOK_S, 1.0)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(seconds), int(rest * 1e6)))
    return link


class LinkLoop:
    """One per process. `run` returns when the parent is gone and the arm is at rest."""

    def __init__(
        self,
        settings: LinkSettings,
        link: socket.socket,
        mailbox: Mailbox,
        *,
        real_time: bool = False,
        locked: bool = False,
    ) -> None:
        self.session = Session(settings)
        self._reader = TelegramReader(settings.send_tags)
        self._link = link
        self._mailbox = mailbox
        self._event_fd = settings.event_fd
        self._granted = (real_time, locked)
        self._peer: Address | None = None
        self._command_number = 0
        self._told: tuple[object, ...] = ()
        self._ending_cycles = 0

    def run(self) -> None:
        """Serve until the parent is gone."""
        self._publish()
        while not self._done():
            received = self._receive()
            if received is None:
                self._look_around()
            else:
                self._serve(*received)

    def _receive(self) -> tuple[bytes, Address] | None:
        """The newest telegram, or None when nothing came for a while."""
        receive, flag = self._link.recvfrom, socket.MSG_DONTWAIT
        try:
            newest: tuple[bytes, Address] = receive(LONGEST_TELEGRAM)
        except OSError:  # the time ran out, or the network said something about an earlier reply
            return None
        try:
            while True:
                newest = receive(LONGEST_TELEGRAM, flag)
                self.session.dropped += 1
        except OSError:
            return newest

    def _serve(self, data: bytes, address: Address) -> None:
        received_ns = time.monotonic_ns()
        session, mailbox = self.session, self._mailbox
        try:
            telegram = self._reader.read(data)
        except BadTelegram:
            session.rejected += 1
            self._look_around()
            return
        orders = mailbox.orders()
        if session.phase is Phase.ARMED:
            mailbox.clear_histogram()
            self._peer = address
        head = session.answer(telegram, orders, received_ns, address != self._peer)
        if head is None:
            self._look_around()
            return
        try:
            self._link.sendto(head + telegram.ipoc + REPLY_TAIL, address)
        except OSError:
            session.rejected += 1
        turnaround_us = (time.monotonic_ns() - received_ns) / 1000.0
        session.after_reply(self._new_command(orders.command_number))
        mailbox.count_turnaround(bin_of(turnaround_us))
        if not session.fault:
            mailbox.record(
                Record(
                    session.cycles,
                    int(telegram.ipoc),
                    received_ns,
                    turnaround_us,
                    session.measured_rad,
                    session.sent_rad,
                    session.choice,
                )
            )
        self._publish()

    def _look_around(self) -> None:
        orders = self._mailbox.orders()
        self.session.idle(orders, time.monotonic_ns())
        command = self._new_command(orders.command_number)
        if command is not None:
            self.session.take(command)
        self._publish()

    def _new_command(self, number: int) -> Command | None:
        """The command block when it holds a command not seen yet and is whole."""
        if number == self._command_number:
            return None
        command = self._mailbox.read_command()
        if command is None or command.number != number:
            return None
        self._command_number = number
        return command

    def _publish(self) -> None:
        real_time, locked = self._granted
        state = self.session.state(real_time=real_time, locked=locked)
        self._mailbox.write_state(state)
        told = (
            state.phase,
            state.fault,
            state.result,
            state.settled,
            state.command_number,
            state.stop_number,
        )
        if told != self._told:
            self._told = told
            os.eventfd_write(self._event_fd, 1)

    def _done(self) -> bool:
        session = self.session
        if not session.parent_gone:
            return False
        if session.phase not in (Phase.RUNNING, Phase.FAULT, Phase.ENDING):
            return True
        if session.phase is Phase.ENDING:
            self._ending_cycles += 1
        return (
            self._ending_cycles > LONGEST_ENDING_CYCLES
            or session.silent_for_ns(time.monotonic_ns()) > QUIET_AFTER_PARENT_NS
        )
