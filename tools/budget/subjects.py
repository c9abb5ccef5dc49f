"""Subjects of the budget: programs, simulators, cases, packages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from statistics import mean
from typing import Any

import psutil

from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.process import describe_exit

ROOT = Path(__file__).resolve().parents[2]
CALIBRATION = Path(__file__).with_name("calibration.py")
LOCK = ROOT / "requirements" / "run.txt"
CALIBRATIONS, MB, SECONDS = "calibrations", "MB", "s"  # units: processor time counts in calibrations
BYTES_PER_MB = 1e6
PROCEDURE, SIMULATOR = "procedures.cli.procedure", "sim.cli"
SIMULATORS = ("polaris", "kuka", "ur", "basler")


@dataclass(frozen=True)
class Measured:
    """One measurement of a budget figure."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Subject:
    """Program or case measured for a figure or several. A quick one is in every check, others in a whole one.

    A `steady` one has figures that are the same on any computer.
    """

    name: str
    measure: Callable[[str], list[Measured]]
    quick: bool
    steady: bool = False


def measure_calibration_s() -> float:
    """Return the processor seconds of the four calibration loops together."""
    return _processor_s([sys.executable, str(CALIBRATION)])[0]


def subjects() -> list[Subject]:
    """List all subjects in the order in which they are measured."""
    mini, dual, default = ("--scene", "mini", "--seed", "7"), ("--dual",), ("--seed", "7")
    return [
        Subject("ronna-procedure --help", _program("--help"), quick=True),
        *(Subject(f"ronna-sim {name}, start", _start_simulator(name), quick=True) for name in SIMULATORS),
        Subject("mini case", _case(*mini), quick=True, steady=True),
        Subject("mini case, two arms", _case(*mini, *dual), quick=True, steady=True),
        Subject("packages", _installed, quick=True, steady=True),
        Subject("phantom", _phantom, quick=False),
        Subject("default case", _case(*default), quick=False, steady=True),
        Subject("make test", _tests, quick=False),
    ]


def _program(*words: str) -> Callable[[str], list[Measured]]:
    def measure(name: str) -> list[Measured]:
        return [_against_calibration(name, lambda: _processor_s(command(PROCEDURE, *words))[0])]

    return measure


def _case(*words: str) -> Callable[[str], list[Measured]]:
    """Measure a simulated case: processor time, theatre time and the bytes of its run folder."""

    def measure(name: str) -> list[Measured]:
        said: dict[str, Any] = {}
        with tempfile.TemporaryDirectory() as folder:

            def run() -> float:
                line = command(PROCEDURE, "run", "--sim", *words, "--out", folder, "--json")
                used_s, output = _processor_s(line)
                said.update(json.loads(output))
                return used_s

            processor = _against_calibration(name, run)
            files = [one for one in Path(folder).rglob("*") if one.is_file()]
            run_mb = sum(one.stat().st_size for one in files) / BYTES_PER_MB
        return [
            processor,
            Measured(f"{name}, theatre time", said["sim_s"], SECONDS),
            Measured(f"{name}, run folder", run_mb, MB),
        ]

    return measure


def _start_simulator(simulator: str) -> Callable[[str], list[Measured]]:
    """Measure a simulator from its start until clients may connect."""

    def start() -> float:
        process = ChildProcess(simulator, command(SIMULATOR, simulator))
        try:
            family = psutil.Process(process.process.pid)
            times = [one.cpu_times() for one in (family, *family.children(recursive=True))]
            used = (one.user + one.system + one.children_user + one.children_system for one in times)
            return float(sum(used))
        finally:
            process.stop()

    return lambda name: [_against_calibration(name, start)]


def _phantom(name: str) -> list[Measured]:
    with tempfile.TemporaryDirectory() as folder:
        line = command(SIMULATOR, "phantom", "--seed", "7", "--out", str(Path(folder) / "phantom"))
        return [_against_calibration(name, lambda: _processor_s(line)[0])]


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
