"""Real-time scheduling and memory locking; the system may refuse either."""

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
    """Lock all pages in memory; True if granted."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() != 0 and limit != resource.RLIM_INFINITY and limit < ENOUGH_LOCKED_BYTES:
        return False  # if granted, it would make later allocations fail
    try:
        return bool(ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)
    except (OSError, AttributeError):
        return False


def run_first(priority: int) -> bool:
    """Run ahead of all ordinary processes (SCHED_FIFO); True if granted. Priority 0 requests nothing."""
    if priority <= 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def sleep_exactly() -> None:
    """Make short sleeps precise (timer slack), also at ordinary priority."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0)


def stop_collecting() -> None:
    """Turn off garbage collection: a control cycle creates no reference cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()


def signal_on_parent_death() -> None:
    """Request a signal when the thread that started us ends; its handler must check the parent process."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, PARENT_DEATH_SIGNAL, 0, 0, 0)
