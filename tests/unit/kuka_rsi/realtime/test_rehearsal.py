"""A rehearsal sends nothing and changes nothing."""

from __future__ import annotations

import socket

import pytest
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, telegram

from drivers.kuka_rsi.realtime.link_state import StopOrder
from drivers.kuka_rsi.realtime.sockets import Rehearsal


def test_a_rehearsal_changes_nothing_and_sends_nothing() -> None:
    link = InProcessLink()
    try:
        link.open()
        link.receive(telegram(FIRST_IPOC))
        link.receive(telegram(FIRST_IPOC + CYCLE_MS))
        session = link.loop.responder
        before = (session.state(real_time=False, locked=False), session.ready, session.cycles)
        sent, memory = len(link.replies.sent), link.mailbox.read_state()
        link.loop._rehearse()
        assert (session.state(real_time=False, locked=False), session.ready, session.cycles) == before
        assert (len(link.replies.sent), link.mailbox.read_state()) == (sent, memory)
        link.stop(StopOrder.PROTECTIVE)
        link.loop._rehearse()  # an order that has come meanwhile is not taken by it
        assert session.state(real_time=False, locked=False) == before[0]
        link.receive(telegram(FIRST_IPOC + 2 * CYCLE_MS))
        assert session.state(real_time=False, locked=False).stop_number == 1
    finally:
        link.close()


def test_a_rehearsal_leaves_nothing_in_its_socket_even_with_foreign_datagrams() -> None:
    rehearsal = Rehearsal()
    try:
        own = rehearsal._own.getsockname()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"mine", own)
        for _ in range(100):
            rehearsal.exchange(telegram(FIRST_IPOC))
        with pytest.raises(BlockingIOError):
            rehearsal._own.recv(100, socket.MSG_DONTWAIT)
    finally:
        rehearsal.close()
