"""For tests in real time: run before everything else on the machine, and know what a process really used."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PRIORITY = 10  # of SCHED_FIFO; any value is before all ordinary processes


@contextlib.contextmanager
def before_everything_else() -> Iterator[bool]:
    """Run at real-time priority, with all that is started now; gives False where that is not allowed."""
    usual, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, usual, parameter)


def used_s(pid: int) -> float:
    """Processor time of a process's main thread so far, to the nanosecond that the scheduler counts."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[0]) / 1e9
