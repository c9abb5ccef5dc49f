"""Wall and processor time of a complete mini case and of the default case, from the command line."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from benchmarks.figures import Figure
from ronna_hw.host.child_process import ChildProcess, command

ROUNDS = 3
SEED = 7
CASE_LIMIT_S = 300.0  # only ends what hangs: a busy computer takes many times as long
START_GOAL_S, MINI_GOAL_S = 1.5, 5.0
DEFAULT_GOAL_S, DEFAULT_CPU_GOAL_S = 12.0, 16.0  # the former is 0.40 of the 30 s that the case once took
SPEED_GOAL = 11.0  # theatre seconds per second of wall time, of the default case
COMMAND, THEATRE = "ronna-procedure run", "ronna-sim theatre, start to READY"


def measure(smallest: bool = False) -> list[Figure]:
    """Measure start-up, the mini case and, except at the smallest size, the default case of `make demo`."""
    rounds = 1 if smallest else ROUNDS
    start_s, mini = [], []
    for _ in range(rounds):
        start_s.append(_time_theatre())
        mini.append(_measure_case("mini"))
    start = Figure("mini case, wall", THEATRE, median(start_s), "s").at_most(START_GOAL_S)
    wall, cpu, speed, error = _make_figures("mini case", mini)
    starts = median(case.wall_s / start for case, start in zip(mini, start_s, strict=True))
    figures = [
        replace(wall, ratio=starts, baseline=THEATRE).at_most(MINI_GOAL_S), start, cpu, speed, error
    ]  # fmt: skip
    if smallest:
        return figures
    wall, cpu, speed, error = _make_figures("default case", [_measure_case("default") for _ in range(rounds)])
    return [
        *figures,
        wall.at_most(DEFAULT_GOAL_S),
        cpu.at_most(DEFAULT_CPU_GOAL_S),
        speed.ratio_at_least(SPEED_GOAL),
        error,
    ]


@dataclass(frozen=True)
class MeasuredCase:
    wall_s: float
    cpu_s: float  # of all processes
    theatre_s: float
    largest_error_mm: float


def _make_figures(what: str, cases: Sequence[MeasuredCase]) -> list[Figure]:
    speed = median(case.theatre_s / case.wall_s for case in cases)
    theatre_s = median(case.theatre_s for case in cases)
    error_mm = median(case.largest_error_mm for case in cases)
    return [
        Figure(f"{what}, wall", COMMAND, median(case.wall_s for case in cases), "s"),
        Figure(f"{what}, CPU of all processes", COMMAND, median(case.cpu_s for case in cases), "s"),
        Figure(f"{what}, theatre time", COMMAND, theatre_s, "s", speed, "wall time", more_is_better=True),
        Figure(f"{what}, largest error at a target", COMMAND, error_mm, "mm"),
    ]


def _time_theatre() -> float:
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        with ChildProcess("ronna-sim theatre", _theatre_command(folder)):
            return time.perf_counter() - began


def _measure_case(scene: str) -> MeasuredCase:
    with tempfile.TemporaryDirectory() as folder:
        before_s, began = _children_cpu_s(), time.perf_counter()
        outcome = _run_case(folder, scene)
        return MeasuredCase(
            wall_s=time.perf_counter() - began,
            cpu_s=_children_cpu_s() - before_s,
            theatre_s=float(outcome["sim_s"]),
            largest_error_mm=float(outcome["max_application_error_mm"]),
        )


def _theatre_command(folder: str) -> list[str]:
    return command(
        "sim.cli", "theatre", "--scene", "mini", "--seed", str(SEED), "--speed", "max", "--out", folder
    )


def _run_case(folder: str, scene: str) -> dict[str, float]:
    program = str(Path(sys.executable).parent / "ronna-procedure")
    arguments = ["run", "--sim", "--scene", scene, "--seed", str(SEED), "--out", folder, "--json"]
    done = subprocess.run(
        [program, *arguments], capture_output=True, text=True, timeout=CASE_LIMIT_S, check=False
    )
    if done.returncode:
        raise RuntimeError(" ".join(done.stderr.split()))
    return dict(json.loads(done.stdout))


def _children_cpu_s() -> float:
    """Return the total CPU seconds of all descendants reaped so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
