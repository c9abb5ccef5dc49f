"""Runs contestants alternately, round after round, so that all see the same variations of the machine."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

Contestant = Callable[[], float]

WARM_UP_ROUNDS = 1
CLOCK_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
UTIME_FIELD = 13  # of /proc/PID/stat, after the name; proc(5)


def contest(
    contestants: Mapping[str, Contestant], rounds: int, *, warm_up: int = WARM_UP_ROUNDS
) -> dict[str, list[float]]:
    """One sample of every contestant per round; the order rotates by one each round."""
    names = list(contestants)
    samples: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(warm_up + rounds):
        at = turn % len(names)
        for name in names[at:] + names[:at]:
            sample = contestants[name]()
            if turn >= warm_up:
                samples[name].append(sample)
    return samples


def cpu_of(work: Callable[[], object], repeats: int = 1) -> float:
    """CPU time of this process per call, seconds, over all its threads."""
    began = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - began) / repeats


def rate_of(work: Callable[[], object], duration_s: float) -> tuple[float, float]:
    """Calls per second of wall time over a period, and CPU seconds per call."""
    count = 0
    cpu, began = time.process_time(), time.perf_counter()
    ending = began + duration_s
    while (now := time.perf_counter()) < ending:
        work()
        count += 1
    elapsed = time.perf_counter() - began if count == 0 else now - began
    return count / elapsed, (time.process_time() - cpu) / max(count, 1)


def family_cpu_s(pid: int) -> float:
    """The same for a process and all its descendants."""
    total = process_cpu_s(pid)
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text(encoding="ascii").split():
            total += family_cpu_s(int(child))
    return total


def process_cpu_s(pid: int) -> float:
    """CPU time used so far by another process, seconds, with the resolution of the system clock's tick."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    fields = text[text.rindex(")") + 2 :].split()
    user, system = (int(value) for value in fields[UTIME_FIELD - 2 : UTIME_FIELD])
    return (user + system) / CLOCK_TICKS_PER_S
