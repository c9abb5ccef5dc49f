"""Subjects of the budget: programs, simulators, cases, packages.

Processor time is measured well on a quiet computer alone. Steady figures are the same on any: theatre time,
bytes, and the calls of Python functions that a program's main thread makes, in which two runs of a case
differ by less than a thousandth.
"""

from __future__ import annotations

import json
import os
import pstats
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from statistics import mean

import psutil

from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.process import describe_exit

ROOT = Path(__file__).resolve().parents[2]
CALIBRATION = Path(__file__).with_name("calibration.py")
LOCK = ROOT / "requirements" / "run.txt"
CALIBRATIONS, CALLS, MB, SECONDS = (
    "calibrations",
    "k calls",
    "MB",
    "s",
)  # processor time counts in calibrations
BYTES_PER_MB = 1e6
CALLS_PER_K = 1e3
PROCEDURE, SIMULATOR = "procedures.cli.procedure", "sim.cli"
SIMULATORS = ("polaris", "kuka", "ur", "basler")
RESULTS = "{results}"  # word of a command line that stands for a folder of its own
PROFILE = "profile"  # file of Python's profiler


@dataclass(frozen=True)
class Measured:
    """One measurement of a budget figure."""

    name: str
    value: float
    unit: str


Measure = Callable[[str], list[Measured]]  # the figures of a name


@dataclass(frozen=True)
class Subject:
    """Program or case with its figures. A quick one is in every check, others in a whole one."""

    name: str
    processor: Measure | None = None
    steady: Measure | None = None
    quick: bool = True


def measure_calibration_s() -> float:
    """Return the processor seconds of the four calibration loops together."""
    return _processor_s([sys.executable, str(CALIBRATION)])[0]


def subjects() -> list[Subject]:
    """List all subjects in the order in which they are measured."""
    mini, default = ("--scene", "mini", "--seed", "7"), ("--seed", "7")
    return [
        _program("ronna-procedure --help", PROCEDURE, "--help"),
        *(_simulator(name) for name in SIMULATORS),
        _program("phantom", SIMULATOR, "phantom", "--seed", "7", "--out", RESULTS),
        _case("mini case", *mini),
        _case("mini case, two arms", *mini, "--dual"),
        Subject("packages", steady=_installed),
        _case("default case", *default, quick=False),
        Subject("make test", _tests, quick=False),
    ]


def _program(name: str, module: str, *words: str) -> Subject:
    """Make a subject of a program that writes to `RESULTS`, if anywhere."""

    def processor(name: str) -> list[Measured]:
        with tempfile.TemporaryDirectory() as folder:
            line = _with_results(command(module, *words), folder)
            return [_against_calibration(name, lambda: _processor_s(line)[0])]

    def steady(name: str) -> list[Measured]:
        with tempfile.TemporaryDirectory() as folder:
            profile = Path(folder) / PROFILE
            _processor_s(_with_results(_profiled(command(module, *words), profile), folder))
            return [_calls(name, profile)]

    return Subject(name, processor, steady)


def _case(name: str, *words: str, quick: bool = True) -> Subject:
    """Make a subject of a simulated case; steady are calls, theatre time and bytes of its run folder."""
    line = command(PROCEDURE, "run", "--sim", *words, "--json", "--out", RESULTS)

    def processor(name: str) -> list[Measured]:
        with tempfile.TemporaryDirectory() as folder:
            return [_against_calibration(name, lambda: _processor_s(_with_results(line, folder))[0])]

    def steady(name: str) -> list[Measured]:
        with tempfile.TemporaryDirectory() as folder:
            profile, runs = Path(folder) / PROFILE, Path(folder) / "runs"
            _, output = _processor_s(_with_results(_profiled(line, profile), str(runs)))
            run_mb = sum(one.stat().st_size for one in runs.rglob("*") if one.is_file()) / BYTES_PER_MB
            return [
                _calls(name, profile),
                Measured(f"{name}, theatre time", json.loads(output)["sim_s"], SECONDS),
                Measured(f"{name}, run folder", run_mb, MB),
            ]

    return Subject(name, processor, steady, quick)


def _simulator(simulator: str) -> Subject:
    """Make a subject of a simulator, from its start until clients may connect."""
    line = command(SIMULATOR, simulator)

    def start() -> float:
        process = ChildProcess(simulator, line)
        try:
            family = psutil.Process(process.process.pid)
            times = [one.cpu_times() for one in (family, *family.children(recursive=True))]
            used = (one.user + one.system + one.children_user + one.children_system for one in times)
            return float(sum(used))
        finally:
            process.stop()

    def steady(name: str) -> list[Measured]:
        with tempfile.TemporaryDirectory() as folder:
            profile = Path(folder) / PROFILE
            ChildProcess(simulator, _profiled(line, profile)).stop()
            return [_calls(name, profile)]

    return Subject(f"ronna-sim {simulator}, start", lambda name: [_against_calibration(name, start)], steady)


def _profiled(line: Sequence[str], profile: Path) -> list[str]:
    """Put a command line of `command` under Python's profiler."""
    python, isolated, *rest = line
    return [python, isolated, "-m", "cProfile", "-o", str(profile), *rest]


def _with_results(line: Sequence[str], folder: str) -> list[str]:
    return [str(Path(folder) / "results") if word == RESULTS else word for word in line]


def _calls(name: str, profile: Path) -> Measured:
    total_calls: int = vars(pstats.Stats(str(profile)))["total_calls"]
    return Measured(f"{name}, calls", total_calls / CALLS_PER_K, CALLS)


def _tests(name: str) -> list[Measured]:
    return [_against_calibration(name, lambda: _processor_s(["make", "-s", "-C", str(ROOT), "test"])[0])]


def _installed(name: str) -> list[Measured]:
    """Measure the packages that a case needs, as their wheels recorded them."""
    locked = {line.split("==")[0].strip() for line in LOCK.read_text().splitlines() if "==" in line}
    files = [
        file
        for one in metadata.distributions()
        if one.name.lower().replace("_", "-") in locked
        for file in one.files or ()
    ]
    return [Measured(name, sum(file.size or 0 for file in files) / BYTES_PER_MB, MB)]


def _against_calibration(name: str, run: Callable[[], float]) -> Measured:
    before_s = measure_calibration_s()
    used_s = run()
    return Measured(name, used_s / mean((before_s, measure_calibration_s())), CALIBRATIONS)


def _processor_s(line: Sequence[str]) -> tuple[float, str]:
    """Run a program; return the processor seconds of all its processes, and what it printed.

    Raises RuntimeError if it fails.
    """
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as messages:
        process = subprocess.Popen(line, stdout=output, stderr=messages, stdin=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        messages.seek(0)
        if process.returncode:
            said = " ".join(messages.read().split()[-40:])
            raise RuntimeError(f"{' '.join(line)}: {describe_exit(process.returncode)}: {said}")
        return used.ru_utime + used.ru_stime, output.read()
