"""What a hostile input may cost: memory and processor time, held while a parser works."""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

MEMORY_BYTES = 300 << 20
LIMIT_S = 5.0


@contextlib.contextmanager
def bounded_cost(memory_bytes: int = MEMORY_BYTES, limit_s: float = LIMIT_S) -> Iterator[None]:
    """Memory beyond the bound cannot be had inside; AssertionError for more processor time."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + memory_bytes, before[1]))
    begun_s = time.thread_time()
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    spent_s = time.thread_time() - begun_s
    assert spent_s < limit_s, f"{spent_s:.1f} s of processor time"


def cpu_median_s(call: Callable[[], object], times: int) -> float:
    """Median processor time of a call, to be compared with another's of the same moment."""
    spent_s = []
    for _ in range(times):
        begun_s = time.thread_time()
        call()
        spent_s.append(time.thread_time() - begun_s)
    return median(spent_s)
