"""Wall time of a complete mini case and of the demo, run from the command line."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from benchmarks.figures import Figure
from ronna_hw.host.child_process import ChildProcess, command

ROUNDS = 3
SEED = 7
CASE_LIMIT_S = 300.0  # only ends what hangs: a busy computer takes many times as long
GOAL_S, DEMO_GOAL_S = 5.0, 60.0
COMMAND, THEATRE = "ronna-procedure run", "ronna-sim theatre, start to READY"


def measure(smallest: bool = False) -> list[Figure]:
    """Measure the mini case and, except at the smallest size, the demo (the default case)."""
    wall_s: list[float] = []
    theatre_s: list[float] = []
    cpu_s: list[float] = []
    start_s: list[float] = []
    error_mm: list[float] = []
    for _ in range(1 if smallest else ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            with ChildProcess("ronna-sim theatre", _theatre_command(folder)):
                start_s.append(time.perf_counter() - began)
        with tempfile.TemporaryDirectory() as folder:
            before_s, began = _children_cpu_s(), time.perf_counter()
            outcome = _run_case(folder, "mini", CASE_LIMIT_S)
            wall_s.append(time.perf_counter() - began)
            cpu_s.append(_children_cpu_s() - before_s)
            theatre_s.append(float(outcome["sim_s"]))
            error_mm.append(float(outcome["max_application_error_mm"]))
    speed = median(theatre / wall for theatre, wall in zip(theatre_s, wall_s, strict=True))
    starts = median(wall / start for wall, start in zip(wall_s, start_s, strict=True))
    figures = [
        Figure("mini case, wall", COMMAND, median(wall_s), "s", starts, THEATRE).at_most(GOAL_S),
        Figure("mini case, wall", THEATRE, median(start_s), "s"),
        Figure("mini case, CPU of all processes", COMMAND, median(cpu_s), "s"),
        Figure(
            "mini case, theatre time",
            COMMAND,
            median(theatre_s),
            "s",
            speed,
            "wall time",
            more_is_better=True,
        ),
        Figure("mini case, largest error at a target", COMMAND, median(error_mm), "mm"),
    ]
    return figures if smallest else [*figures, _time_demo()]


def _time_demo() -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        _run_case(folder, "default", 2 * DEMO_GOAL_S)
        demo_s = time.perf_counter() - began
    return Figure("case of `make demo`, wall", COMMAND, demo_s, "s").at_most(DEMO_GOAL_S)


def _theatre_command(folder: str) -> list[str]:
    return command(
        "sim.cli", "theatre", "--scene", "mini", "--seed", str(SEED), "--speed", "max", "--out", folder
    )


def _run_case(folder: str, scene: str, limit_s: float) -> dict[str, float]:
    program = str(Path(sys.executable).parent / "ronna-procedure")
    arguments = ["run", "--sim", "--scene", scene, "--seed", str(SEED), "--out", folder, "--json"]
    done = subprocess.run([program, *arguments], capture_output=True, text=True, timeout=limit_s, check=False)
    if done.returncode:
        raise RuntimeError(" ".join(done.stderr.split()))
    return dict(json.loads(done.stdout))


def _children_cpu_s() -> float:
    """Return the total CPU seconds of all descendants reaped so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
