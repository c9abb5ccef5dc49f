"""Mutated telegrams through the driver's session: no crash, and no motion."""

from __future__ import annotations

import socket
import time

from mutations import mutations
from responder_stand import LIMITS
from rsi_loop import CYCLE_MS, FIRST_IPOC, START_DEG, corrections_of, telegram
from rsi_mutants import answer_mutants

from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_state import CommandKind, Phase
from drivers.kuka_rsi.stream import link_settings
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import load_context

THROUGH_THE_SESSION = 3_000
OVER_THE_SOCKET = 2_000
FRESH_EVERY = 200  # mutants over the socket: some of them end a session, as telegrams of another run
GENEROUS_S = 30.0


def test_mutants_in_a_session_cause_no_motion() -> None:
    answered, refused = answer_mutants(THROUGH_THE_SESSION, seed=1)
    assert answered > THROUGH_THE_SESSION / 100  # some are still telegrams
    assert refused > THROUGH_THE_SESSION / 3


def test_mutants_over_the_socket_cause_no_crash_and_no_motion() -> None:
    endpoint = parse_endpoint(own_udp_endpoint())
    options = KukaOptions(silence_limit_s=60.0, heartbeat_limit_s=60.0, real_time_priority=0)
    link = LinkClient(link_settings(endpoint, load_context(), options))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
            controller.connect((endpoint.host, endpoint.port))
            controller.settimeout(GENEROUS_S)
            ipoc = FIRST_IPOC
            for number, mutant in enumerate(mutations([telegram(0)], OVER_THE_SOCKET, seed=2)):
                if number % FRESH_EVERY == 0:
                    ipoc += CYCLE_MS
                    _answered(controller, link, ipoc)
                controller.send(mutant)
            _answered(controller, link, ipoc + CYCLE_MS)
            assert link.alive
            assert not link.state.moving
    finally:
        link.close()


def _answered(controller: socket.socket, link: LinkClient, ipoc: int) -> None:
    """A fresh session answers a telegram as it should, whatever came before."""
    link.command(CommandKind.CLOSE)
    link.wait(lambda s: s.phase is Phase.IDLE, GENEROUS_S)
    number = link.command(CommandKind.OPEN, limits=LIMITS)
    link.wait(lambda s: s.command_number >= number, GENEROUS_S)
    deadline = time.monotonic() + GENEROUS_S
    while time.monotonic() < deadline:
        controller.send(telegram(ipoc, START_DEG))
        reply = controller.recv(4096)
        assert corrections_of(reply) == (0.0,) * 6
        if b"<IPOC>%d</IPOC>" % ipoc in reply:
            return
    raise AssertionError("no reply")
