"""Pins the real-time process to the processor that receives its telegrams.

Waking up there needs no interrupt to another, possibly halted, processor, and the telegram is still in the
caches. The process has priority over all others, so being pinned does not make it wait.
"""

from __future__ import annotations

import os

SURE_AFTER_TELEGRAMS = 2  # consecutive, on the same other processor; a single one is no reason to move


class ProcessorAffinity:
    """Affinity of the calling thread. Without real-time priority a process stays where the system puts it."""

    def __init__(self, *, follows: bool) -> None:
        self._allowed = os.sched_getaffinity(0)
        self._follows = follows and len(self._allowed) > 1
        self._pinned_to: int | None = None  # None: any processor
        self._last = -1  # received the last telegram
        self._consecutive = 0

    def follow(self, processor: int) -> None:
        """Follow a telegram that was received on this processor; -1 for unknown."""
        if processor == self._pinned_to or not self._follows:
            return
        self._consecutive = self._consecutive + 1 if processor == self._last else 1
        self._last = processor
        if self._consecutive >= SURE_AFTER_TELEGRAMS and processor in self._allowed:
            self._restrict({processor})
            self._pinned_to = processor

    def free(self) -> None:
        """Undo the pinning: in lock-step, sender and receiver run better in parallel."""
        if self._pinned_to is not None:
            self._restrict(self._allowed - {self._pinned_to})  # otherwise it would stay where it is
            self._restrict(self._allowed)
            self._pinned_to = None

    def _restrict(self, allowed: set[int]) -> None:
        try:
            os.sched_setaffinity(0, allowed)
        except OSError:  # the system took the processor away
            self._follows = False
