"""Faults of the RSI link: what becomes of a telegram on its way out, and of a reply on its way in.

Counted in cycles, so that in lock-step, too, a reply is dropped or late by the controller's own time. Chances
are drawn by cycle number and not one after another: the same cycles are met whatever was met before.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from sim.kuka.fault_log import FaultLog
from sim.kuka.reply import Reply
from sim.theatre.faults import Fault
from sim.theatre.noise import noise

PERCENT = 100.0
STAMP = re.compile(rb"(?<=<IPOC>)\d+(?=</IPOC>)")
WRONG_BY = 1  # ms: no cycle ever has such a time stamp
NOT_TEXT = 0xFF  # a byte that no XML holds: what it hits is no telegram and no reply any more


class LinkFaults:
    """One per controller. `begin_cycle` tells which faults act; then the telegram, then the reply."""

    def __init__(self, seed: int, log: FaultLog) -> None:
        self._seed = seed
        self._log = log
        self._cycle = 0
        self._acting: dict[str, list[Fault]] = {}
        self._under_way: list[tuple[int, bytes]] = []  # cycle of arrival, datagram

    @property
    def idle(self) -> bool:
        """True while nothing acts and nothing is under way."""
        return not self._acting and not self._under_way

    def look(self, acting: tuple[Fault, ...]) -> None:
        """Take over which faults act now."""
        self._acting = {}
        for fault in acting:
            self._acting.setdefault(fault.kind.name, []).append(fault)

    def begin_cycle(self, cycle: int) -> None:
        """Say which cycle begins."""
        self._cycle = cycle

    def begin_run(self) -> None:
        """Forget what was under way to the run before."""
        self._under_way.clear()

    def acts(self, kind: str) -> bool:
        """True while a lasting fault of that kind acts."""
        return kind in self._acting

    def outgoing(self, telegram: bytes) -> tuple[bytes | None, bool]:
        """What leaves, None when nothing does; and whether the client can answer it."""
        if self.acts("network_cut") or self._meets("lose_telegrams"):
            return None, False
        if self._meets("corrupt_telegrams"):
            return self._broken(telegram, "corrupt_telegrams"), False
        return telegram, True

    def incoming(self, datagram: bytes | None, read: Callable[[bytes], Reply | None]) -> Reply | None:
        """The reply that this cycle gets, when the client has sent `datagram`."""
        now = [data for arrival, data in self._under_way if arrival <= self._cycle]
        self._under_way = [item for item in self._under_way if item[0] > self._cycle]
        if datagram is not None:
            now = self._on_the_way(datagram, now)
        if self.acts("network_cut"):
            return None
        replies = [reply for reply in map(read, now) if reply is not None]
        return replies[0] if replies else None

    def _on_the_way(self, datagram: bytes, before: list[bytes]) -> list[bytes]:
        if self._meets("drop"):
            return before
        if self._meets("corrupt_replies"):
            datagram = self._broken(datagram, "corrupt_replies")
        if self._meets("wrong_ipoc"):
            datagram = STAMP.sub(lambda stamp: b"%d" % (int(stamp[0]) + WRONG_BY), datagram)
        copies = [datagram, datagram] if self._meets("duplicate_replies") else [datagram]
        delay_cycles = max(
            (int(fault.argument) for fault in self._acting.get("delay_replies", ())), default=0
        )
        if delay_cycles:
            self._log.hit("delay_replies")
            self._under_way += [(self._cycle + delay_cycles, copy) for copy in copies]
            return before
        if self._meets("reorder_replies"):
            self._under_way += [(self._cycle + 1, copy) for copy in copies]
            return before
        # What was overtaken comes after what has overtaken it.
        return [*copies, *before]

    def _meets(self, kind: str) -> bool:
        shares = [float(fault.argument) for fault in self._acting.get(kind, ())]
        if not shares or self._chance(kind).random() * PERCENT >= max(shares):
            return False
        self._log.hit(kind)
        return True

    def _broken(self, data: bytes, kind: str) -> bytes:
        """Cut short, or with one byte that cannot be."""
        chance = self._chance(kind)
        chance.random()  # the number that decided that it is met
        place = int(chance.integers(0, len(data)))
        if chance.random() < 0.5:
            return data[:place]
        return data[:place] + bytes([NOT_TEXT]) + data[place + 1 :]

    def _chance(self, kind: str) -> np.random.Generator:
        return noise(self._seed, f"robot {kind}", self._cycle)
