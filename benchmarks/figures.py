"""Benchmark figures with baselines from the same run, and contests in alternating rounds."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Self


@dataclass(frozen=True)
class Figure:
    """A measured value. `ratio` compares it with the baseline measured in the same rounds.

    `goal` states the goal in words; `met` is None without a goal.
    """

    what: str
    who: str
    value: float
    unit: str
    ratio: float | None = None
    baseline: str = ""
    more: dict[str, float] = field(default_factory=dict)  # only for the JSON output, such as p99
    goal: str = ""
    met: bool | None = None
    more_is_better: bool | None = None  # for the history; None: the unit says it, or nothing does

    def at_least(self, limit: float) -> Self:
        return replace(self, goal=f"value ≥ {limit:,g}", met=self.value >= limit, more_is_better=True)

    def at_most(self, limit: float) -> Self:
        return replace(self, goal=f"value ≤ {limit:g}", met=self.value <= limit, more_is_better=False)

    def within(self, low: float, high: float) -> Self:
        return replace(self, goal=f"{low:g} to {high:g}", met=low <= self.value <= high)

    def ratio_at_least(self, limit: float) -> Self:
        """Set a minimum ratio as the goal; raises ValueError without a baseline."""
        if self.ratio is None:
            raise ValueError("a goal for a ratio needs a baseline")
        return replace(self, goal=f"ratio ≥ {limit:.3g}", met=self.ratio >= limit, more_is_better=True)

    def ratio_at_most(self, limit: float) -> Self:
        """Set a maximum ratio as the goal; raises ValueError without a baseline."""
        if self.ratio is None:
            raise ValueError("a goal for a ratio needs a baseline")
        return replace(self, goal=f"ratio ≤ {limit:.3g}", met=self.ratio <= limit, more_is_better=False)


def compare_samples(
    what: str, unit: str, samples: Mapping[str, Sequence[float]], baseline: str, *, scale: float = 1.0
) -> list[Figure]:
    """Return each contestant's median, and the median of its per-round ratios to the baseline.

    A machine that stalls does so for every contestant in the round: ratios within a round preserve what
    medians over the run lose.
    """
    base = samples[baseline]
    figures = []
    for who, values in samples.items():
        ratio = None
        if who != baseline:
            ratios = [one / other for one, other in zip(values, base, strict=True) if other]
            ratio = median(ratios) if ratios else None  # none of what is too short for the clock
        figures.append(
            Figure(what, who, median(values) * scale, unit, ratio, baseline if ratio is not None else "")
        )
    return figures


Contestant = Callable[[], float]

WARM_UP_ROUNDS = 1
CLOCK_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
UTIME_FIELD = 13  # of /proc/PID/stat, after the name; proc(5)


def run_contest(
    contestants: Mapping[str, Contestant], rounds: int, *, warm_up: int = WARM_UP_ROUNDS
) -> dict[str, list[float]]:
    """Sample every contestant once per round, rotating the order by one each round."""
    names = list(contestants)
    samples: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(warm_up + rounds):
        at = turn % len(names)
        for name in names[at:] + names[:at]:
            sample = contestants[name]()
            if turn >= warm_up:
                samples[name].append(sample)
    return samples


def measure_cpu_s(work: Callable[[], object], repeats: int = 1) -> float:
    """Return the CPU seconds of this process per call, over all its threads."""
    began = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - began) / repeats


# A process counts as its own the memory of the one that started it: one with little memory stands in between.
_METER = """
import resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
sys.exit(code)
"""
BYTES_PER_KIB, BYTES_PER_GB = 1024, 1e9


def measure_program(line: Sequence[str]) -> tuple[float, float]:
    """Run a program; return its CPU seconds and peak memory in GB. Raises RuntimeError if it fails."""
    done = subprocess.run([sys.executable, "-c", _METER, *line], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(" ".join(done.stderr.split()) or f"exit code {done.returncode}")
    cpu_s, peak_kib = map(float, done.stdout.split())
    return cpu_s, peak_kib * BYTES_PER_KIB / BYTES_PER_GB


def measure_rate(work: Callable[[], object], duration_s: float) -> tuple[float, float]:
    """Return calls per second of wall time over a period, and CPU seconds per call."""
    count = 0
    cpu, began = time.process_time(), time.perf_counter()
    ending = began + duration_s
    while (now := time.perf_counter()) < ending:
        work()
        count += 1
    elapsed = time.perf_counter() - began if count == 0 else now - began
    return count / elapsed, (time.process_time() - cpu) / max(count, 1)


def family_cpu_s(pid: int) -> float:
    """Return the total CPU seconds of a process and all its descendants."""
    total = process_cpu_s(pid)
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text(encoding="ascii").split():
            total += family_cpu_s(int(child))
    return total


def process_cpu_s(pid: int) -> float:
    """Return the CPU seconds used so far by another process, with the resolution of the system tick."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    fields = text[text.rindex(")") + 2 :].split()
    user, system = (int(value) for value in fields[UTIME_FIELD - 2 : UTIME_FIELD])
    return (user + system) / CLOCK_TICKS_PER_S
