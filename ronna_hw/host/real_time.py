"""Scheduling and memory locking for real-time processes; the system may refuse either."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import signal

_MCL_CURRENT_AND_FUTURE = 3
_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29
_LEAST_SLACK_NS = 1  # the usual 50,000 would double every short sleep
ENOUGH_LOCKED_BYTES = 1 << 30  # several times what the process maps
PARENT_DEATH_SIGNAL = signal.SIGUSR1  # SIGTERM is an order to end


def lock_memory() -> bool:
    """Lock all pages in memory; returns whether the system granted it."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() != 0 and limit != resource.RLIM_INFINITY and limit < ENOUGH_LOCKED_BYTES:
        return False  # if granted, it would make later allocations fail
    try:
        return bool(ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)
    except (OSError, AttributeError):
        return False


def request_priority(priority: int) -> bool:
    """Request real-time priority (SCHED_FIFO) over all ordinary processes; returns whether granted.

    Priority 0 requests nothing.
    """
    if priority <= 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def make_sleep_precise() -> None:
    """Make short sleeps precise by reducing the timer slack, even at ordinary priority."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0)


def stop_garbage_collection() -> None:
    """Turn off garbage collection for a control cycle that creates no reference cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()


def signal_on_parent_death() -> None:
    """Request a signal for when the thread that started this process ends.

    Its handler must check the parent process.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, PARENT_DEATH_SIGNAL, 0, 0, 0)


SURE_AFTER_TELEGRAMS = 2  # consecutive, on the same other processor; a single one is no reason to move


class ProcessorAffinity:
    """CPU placement of the calling thread: near a paced sender, or away from a lock-step sender.

    `follow`: waking up on the processor that receives the telegrams needs no interrupt to another, possibly
    halted, processor, and the telegram is still in the caches. `avoid`: with priority over all others the
    thread would keep the sender, on its own processor, from working while it prepares the next reply.
    Without real-time priority it stays where the system puts it.
    """

    def __init__(self, *, follows: bool) -> None:
        self._allowed = os.sched_getaffinity(0)
        self._follows = follows and len(self._allowed) > 1
        self._pinned_to: int | None = None  # None: any processor
        self._avoided: int | None = None
        self._last = -1  # received the last telegram
        self._consecutive = 0

    @property
    def has_others(self) -> bool:
        """Whether the process may use more than one processor, so that a sender can have its own."""
        return len(self._allowed) > 1

    def follow(self, processor: int) -> None:
        """Record the processor that received a telegram (-1: unknown), and move there once it is stable."""
        if processor == self._pinned_to or not self._follows:
            return
        self._consecutive = self._consecutive + 1 if processor == self._last else 1
        self._last = processor
        if self._consecutive >= SURE_AFTER_TELEGRAMS and processor in self._allowed:
            self._restrict({processor})
            self._pinned_to, self._avoided = processor, None

    def avoid(self, processor: int) -> None:
        """Avoid the sender's processor (-1: unknown)."""
        if not self._follows or processor == self._avoided or processor not in self._allowed:
            return
        self._restrict(self._allowed - {processor})
        self._pinned_to, self._avoided = None, processor

    def free(self) -> None:
        """Allow any processor again."""
        if self._pinned_to is not None or self._avoided is not None:
            self._restrict(self._allowed)
            self._pinned_to = self._avoided = None

    def _restrict(self, allowed: set[int]) -> None:
        try:
            os.sched_setaffinity(0, allowed)
        except OSError:  # the system took the processor away
            self._follows = False
