"""When the machine itself held things up: a virtual processor may get no time for tens of milliseconds.

A test in real time can then tell what it missed from what it was not given. Where the system allows it, the
test and all that it starts run before everything else on the machine; what a pseudo-terminal carries is still
passed on by a thread of the kernel that waits its turn, so it is a pseudo-terminal that is watched.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from types import TracebackType
from typing import Self

PRIORITY = 10  # of SCHED_FIFO; any value is before all ordinary processes
STALL_S = 0.004
WATCH = """
import os, sys, time, tty
os.sched_setaffinity(0, {int(sys.argv[1])})
limit_s = float(sys.argv[2])
near, far = os.openpty()
tty.setraw(far)
print(flush=True)
before_s = time.monotonic()
while True:
    time.sleep(0.001)
    os.write(near, b".")
    os.read(far, 1)
    now_s = time.monotonic()
    if now_s - before_s > limit_s:
        print(before_s, now_s, flush=True)
    before_s = now_s
"""


@contextlib.contextmanager
def before_everything_else() -> Iterator[bool]:
    """Run at real-time priority; gives False where that is not allowed, and changes nothing then."""
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


class MachineStalls:
    """Watches from every processor while it is open. `spans` then holds begin and end, host's monotonic."""

    def __init__(self) -> None:
        self.spans: list[tuple[float, float]] = []
        self._watches: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Self:
        for cpu in sorted(os.sched_getaffinity(0)):
            watch = subprocess.Popen(
                [sys.executable, "-P", "-c", WATCH, str(cpu), str(STALL_S)],
                stdout=subprocess.PIPE,
                text=True,
            )
            self._watches.append(watch)
            assert watch.stdout is not None
            watch.stdout.readline()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for watch in self._watches:
            watch.kill()
            output, _ = watch.communicate()
            lines = output.split("\n")[:-1]  # the last may be cut
            self.spans += [(float(begin), float(end)) for begin, end in map(str.split, lines)]

    def overlap(self, begin_s: float, end_s: float) -> bool:
        """True when a byte took too long at some time in between."""
        return any(begin < end_s and begin_s < end for begin, end in self.spans)
