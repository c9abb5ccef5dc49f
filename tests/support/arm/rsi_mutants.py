"""Mutated telegrams of the controller through a session of the driver's link."""

from __future__ import annotations

from mutations import mutations
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, corrections_of, telegram

from drivers.kuka_rsi.realtime.link_state import Phase

ORIGINALS = (telegram(0), telegram(0, delay=7), telegram(0, (12.5, -80.0, 95.25, 3.0, 61.0, -9.0)))


def answer_mutants(count: int, seed: int) -> tuple[int, int]:
    """Count mutants answered and not answered; every reply must command no motion."""
    link = InProcessLink()
    link.open()
    ipoc, answered = FIRST_IPOC, 0
    now = [original.replace(b"<IPOC>0<", b"<IPOC>%(now)<") for original in ORIGINALS]
    for mutant in mutations(now, count, seed):
        if link.loop.responder.phase is not Phase.RUNNING:
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
