"""Mutated telegrams of the controller through the driver's codec, and through a session of its link."""

from __future__ import annotations

from math import isfinite

from mutations import mutations
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, corrections_of, telegram

from drivers.kuka_rsi.errors import BadTelegram
from drivers.kuka_rsi.realtime.link_state import Phase
from drivers.kuka_rsi.realtime.telegram import TelegramReader

TAGS = ("DEF_RIst", "DEF_AIPos", "DEF_EIPos", "DEF_Delay")
ORIGINALS = (telegram(0), telegram(0, delay=7), telegram(0, (12.5, -80.0, 95.25, 3.0, 61.0, -9.0)))


def read_mutants(count: int, seed: int) -> tuple[int, int]:
    """Mutants read and refused by the codec; what is read must be numbers that the bytes hold."""
    reader, read = TelegramReader(TAGS), 0
    for mutant in mutations(ORIGINALS, count, seed):
        try:
            found = reader.read(mutant)
        except BadTelegram:
            continue
        read += 1
        assert all(isfinite(angle) for angle in found.axes_deg)
        assert found.ipoc.isdigit()
        assert found.ipoc in mutant
        assert b"KUKA" in mutant
    return read, count - read


def answer_mutants(count: int, seed: int) -> tuple[int, int]:
    """Mutants answered and not answered; every reply must command no motion."""
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
