"""Keeps the real-time process on the processor that takes its telegrams in.

There it is woken without a word to another processor that may be halted, with the telegram still in the
caches. As it runs before all others, being tied to one processor does not make it wait.
"""

from __future__ import annotations

import os

SURE_AFTER_TELEGRAMS = 2  # in a row by the same other processor: an odd one is no reason to move


class Processor:
    """Of the calling thread. A process that does not run first is left where the system puts it."""

    def __init__(self, *, follows: bool) -> None:
        self._allowed = os.sched_getaffinity(0)
        self._follows = follows and len(self._allowed) > 1
        self._at: int | None = None  # where the thread is kept; None for anywhere
        self._last = -1  # the last telegram came by
        self._times = 0  # in a row

    def follow(self, processor: int) -> None:
        """A telegram was taken in by this one; -1 for unknown."""
        if processor == self._at or not self._follows:
            return
        self._times = self._times + 1 if processor == self._last else 1
        self._last = processor
        if self._times >= SURE_AFTER_TELEGRAMS and processor in self._allowed:
            self._keep({processor})
            self._at = processor

    def free(self) -> None:
        """Nobody keeps a pace: two that take turns do better side by side."""
        if self._at is not None:
            self._keep(self._allowed - {self._at})  # left alone, it would stay where it is
            self._keep(self._allowed)
            self._at = None

    def _keep(self, allowed: set[int]) -> None:
        try:
            os.sched_setaffinity(0, allowed)
        except OSError:  # the system has taken the processor away meanwhile
            self._follows = False
