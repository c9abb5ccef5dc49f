"""A session receives only its own controller, on time; others are counted, and the port is exclusive."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator

import pytest
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, telegram

from drivers.kuka_rsi.realtime.sockets import Address, LinkSockets, Rehearsal, bind
from ronna_hw.arm_stream.records import StopOrder

FLOOD = 100


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    with bind("127.0.0.1", 0) as link:
        yield link


@pytest.fixture
def controller(listening: socket.socket) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.connect(listening.getsockname())
        controller.settimeout(30.0)
        yield controller


@pytest.fixture
def sockets(listening: socket.socket) -> Iterator[LinkSockets]:
    sockets = LinkSockets(listening)
    yield sockets
    sockets.disconnect()


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))
        yield stranger


def test_the_controllers_telegram_is_received_next_despite_a_flood_from_a_stranger(
    sockets: LinkSockets, listening: socket.socket, controller: socket.socket, stranger: socket.socket
) -> None:
    peer: Address = controller.getsockname()
    sockets.connect_to(peer)
    for _ in range(FLOOD):
        stranger.sendto(b"mine", listening.getsockname())
    assert not sockets.has_datagram()
    controller.send(b"telegram")
    assert sockets.has_datagram()
    assert sockets.receive() == (b"telegram", peer)
    assert [sockets.foreign_sender() for _ in range(FLOOD)] == [stranger.getsockname()] * FLOOD
    assert sockets.foreign_sender() is None


def test_the_reply_is_sent_from_the_port_the_controller_sends_to(
    sockets: LinkSockets, controller: socket.socket
) -> None:
    sockets.connect_to(controller.getsockname())
    sockets.send(b"reply", controller.getsockname())
    assert controller.recv(100) == b"reply"  # connected: it takes nothing from elsewhere


def test_any_controller_may_start_the_next_session(
    sockets: LinkSockets, listening: socket.socket, controller: socket.socket, stranger: socket.socket
) -> None:
    sockets.connect_to(controller.getsockname())
    sockets.disconnect()
    stranger.sendto(b"telegram", listening.getsockname())
    assert sockets.receive() == (b"telegram", stranger.getsockname())
    sockets.send(b"reply", stranger.getsockname())
    assert stranger.recv(100) == b"reply"


def test_a_new_session_can_be_with_another_controller(
    sockets: LinkSockets, listening: socket.socket, controller: socket.socket, stranger: socket.socket
) -> None:
    sockets.connect_to(controller.getsockname())
    sockets.connect_to(stranger.getsockname())
    controller.send(b"from the last session")
    stranger.sendto(b"telegram", listening.getsockname())
    assert sockets.receive() == (b"telegram", stranger.getsockname())
    assert sockets.foreign_sender() == controller.getsockname()


@pytest.mark.parametrize("in_session", [False, True])
def test_no_other_socket_can_bind_the_port_even_with_address_reuse(
    sockets: LinkSockets, listening: socket.socket, controller: socket.socket, in_session: bool
) -> None:
    sockets.connect_to(controller.getsockname())
    if not in_session:
        sockets.disconnect()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            second.bind(listening.getsockname())


def test_a_link_bound_to_all_addresses_receives_a_controller_on_any_of_them() -> None:
    with bind("0.0.0.0", 0) as everywhere, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        sockets = LinkSockets(everywhere)
        sockets.connect_to(controller.getsockname())
        controller.sendto(b"telegram", ("127.0.0.2", everywhere.getsockname()[1]))
        assert sockets.receive() == (b"telegram", controller.getsockname())
        assert sockets.processor() == -1


def test_the_processor_that_received_a_telegram_is_known_during_a_session(
    sockets: LinkSockets, controller: socket.socket
) -> None:
    def sent_from(processor: int) -> int:
        def send() -> None:
            os.sched_setaffinity(0, {processor})  # of this thread
            controller.send(b"telegram")

        sender = threading.Thread(target=send)
        sender.start()
        sender.join()
        sockets.receive()
        return sockets.processor()

    assert sockets.processor() == -1
    sockets.connect_to(controller.getsockname())
    ours = os.sched_getaffinity(0)
    assert {processor: sent_from(processor) for processor in ours} == {each: each for each in ours}


def slowly(_limit_s: float) -> bool:
    """Something has come; a busy computer takes long to say so."""
    time.sleep(0.001)
    return True


@pytest.mark.parametrize("rehearses", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_only_the_newest_of_several_queued_telegrams_is_taken(rehearses: bool, late: bool) -> None:
    with bind("127.0.0.1", 0) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        own = InProcessLink(link=link, rehearses=rehearses)
        own.open()
        controller.sendto(telegram(FIRST_IPOC - CYCLE_MS), link.getsockname())
        first = own.loop._receive()
        assert first is not None
        own.loop._serve(*first)  # before a session each telegram is looked at: the newest may be a stranger's
        now_ns = time.monotonic_ns()
        for place in reversed(range(40)):  # the pace is known, and the next one due in a moment
            own.loop._receiver._pace.note_arrival(now_ns - place * CYCLE_MS * 1_000_000)
        own.loop._sockets.sleep = slowly  # type: ignore[method-assign]
        own.loop._answered_ns = 0 if late else now_ns + CYCLE_MS * 1_000_000
        held = [telegram(FIRST_IPOC + CYCLE_MS * k) for k in range(5)]
        for each in held:
            controller.sendto(each, link.getsockname())
        taken = own.loop._receive()
        assert taken is not None
        assert taken[0] == held[-1]
        assert own.loop.session.dropped == 4
        own.close()


def test_a_rehearsal_changes_nothing_and_sends_nothing(link: InProcessLink) -> None:
    link.receive(telegram(FIRST_IPOC))
    link.receive(telegram(FIRST_IPOC + CYCLE_MS))
    session = link.loop.session
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
