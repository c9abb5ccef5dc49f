"""Driver's receive loop in process: no sockets, no second process, and a clock that is told."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mutations import mutations
from rsi_stand import LIMITS, SETTINGS, START_DEG

from drivers.kuka_rsi.realtime.loop import LinkLoop
from drivers.kuka_rsi.realtime.sockets import ANY_HOST
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.options import REHEARSAL_LEAD_US
from ronna_hw.arm_stream.records import CloseStream, Command, OpenStream, StopOrder, StreamPhase

CONTROLLER = ("127.0.0.1", 40000)
CYCLE_MS = 4
FIRST_IPOC = 1000
TELEGRAM = (
    '<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    '<AIPos A1="%.4f" A2="%.4f" A3="%.4f" A4="%.4f" A5="%.4f" A6="%.4f"/>'
    '<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
    '<Delay D="%d"/><MACur A1="1.0000" A2="-2.0000" A3="3.0000" A4="0.0000" A5="0.0000" A6="0.0000"/>'
    "<IPOC>%d</IPOC></Rob>"
)
CORRECTIONS = re.compile(rb'A\d="(-?\d+\.\d{6})"')


class SentReplies:
    """Replacement of a socket that keeps the replies."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def sendto(self, data: bytes, _address: object) -> int:
        self.sent.append(data)
        return len(data)

    def getsockname(self) -> tuple[str, int]:
        return ANY_HOST, 1  # never connected


class InProcessLink:
    """Loop with an open session, given telegrams one by one."""

    def __init__(
        self, *, heartbeat_limit_s: float = 60.0, link: socket.socket | None = None, rehearses: bool = False
    ) -> None:
        """Telegrams come by `receive`, or through `link` where one is given."""
        self._memory_fd = os.memfd_create("link under test")
        self._event_fd = os.eventfd(0, os.EFD_NONBLOCK)
        Mailbox.initialise(self._memory_fd)
        self.mailbox = Mailbox(self._memory_fd)
        self.replies = SentReplies()
        settings = replace(
            SETTINGS,
            mailbox_fd=self._memory_fd,
            event_fd=self._event_fd,
            send_tags=("DEF_RIst", "DEF_AIPos", "DEF_EIPos", "DEF_Delay", "DEF_MACur"),
            silence_limit_s=60.0,
            heartbeat_limit_s=heartbeat_limit_s,
            rehearsal_lead_us=REHEARSAL_LEAD_US if rehearses else 0,
        )
        end: Any = self.replies if link is None else link
        self.loop = LinkLoop(settings, end, self.mailbox)
        self.now_ns = 1_000_000_000
        self._commands = 0
        self._stops = 0

    def close(self) -> None:
        self.loop.close()
        self.mailbox.close()
        os.close(self._memory_fd)
        os.close(self._event_fd)

    def give(self, command: Command) -> None:
        """Give a command to the loop, with a new number."""
        self._commands += 1
        self.mailbox.write_command(command._replace(number=self._commands, stop_number=self._stops))

    def open(self) -> None:
        """Open a session as a start of the stream does, whatever was before."""
        self.give(Command(0, CloseStream()))
        self.loop._check_orders()
        self.give(Command(0, OpenStream(LIMITS)))
        self.loop._check_orders()

    def stop(self, kind: StopOrder) -> None:
        self._stops += 1
        self.mailbox.order_stop(self._stops, kind)

    def receive(self, data: bytes) -> bytes | None:
        """Return the reply to a datagram of the controller."""
        self.now_ns += CYCLE_MS * 1_000_000
        self.loop._received_ns = self.now_ns
        before = len(self.replies.sent)
        self.loop._serve(data, CONTROLLER)
        return self.replies.sent[-1] if len(self.replies.sent) > before else None


def telegram(ipoc: int, axes_deg: Sequence[float] = START_DEG, delay: int = 0) -> bytes:
    return (TELEGRAM % (*axes_deg, delay, ipoc)).encode()


def corrections_of(reply: bytes) -> tuple[float, ...]:
    return tuple(float(value) for value in CORRECTIONS.findall(reply))


ORIGINALS = (telegram(0), telegram(0, delay=7), telegram(0, (12.5, -80.0, 95.25, 3.0, 61.0, -9.0)))


def answer_mutants(count: int, seed: int) -> tuple[int, int]:
    """Count mutants answered and not answered; every reply must command no motion."""
    link = InProcessLink()
    link.open()
    ipoc, answered = FIRST_IPOC, 0
    now = [original.replace(b"<IPOC>0<", b"<IPOC>%(now)<") for original in ORIGINALS]
    for mutant in mutations(now, count, seed):
        if link.loop.session.phase is not StreamPhase.RUNNING:
            link.open()
            assert link.receive(telegram(ipoc)) is not None
        ipoc += CYCLE_MS
        reply = link.receive(mutant.replace(b"%(now)", str(ipoc).encode()))
        if reply is not None:
            answered += 1
            assert corrections_of(reply) == (0.0,) * 6
            assert b"<Stop>0</Stop>" in reply
    link.close()
    return answered, count - answered
