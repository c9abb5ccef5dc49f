"""What a process can ask of the system to be on time. Each wish may be refused; the process goes on."""

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
PARENT_DEATH_SIGNAL = signal.SIGUSR1  # not SIGTERM: that one means what it says


def lock_memory() -> bool:
    """Keep all pages in memory; True when granted."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() != 0 and limit != resource.RLIM_INFINITY and limit < ENOUGH_LOCKED_BYTES:
        return False  # granted now, it would refuse memory later on
    try:
        return bool(ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)
    except (OSError, AttributeError):
        return False


def run_first(priority: int) -> bool:
    """Run before all ordinary processes (SCHED_FIFO); True when granted. Priority 0 asks for nothing."""
    if priority <= 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def sleep_exactly() -> None:
    """Let short sleeps end when they are over, also for a process of ordinary priority."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0)


def stop_collecting() -> None:
    """No garbage collection from now on: a cycle makes no reference loops."""
    gc.collect()
    gc.freeze()
    gc.disable()


def tell_parent_death() -> None:
    """Ask for a signal when the thread that started us ends; whoever handles it must look at the parent."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, PARENT_DEATH_SIGNAL, 0, 0, 0)
