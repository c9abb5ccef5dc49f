"""Spheres in phantom scans: cost beside bare reading, error beside the thesis' methods and the bound.

The scans come from `ronna-sim phantom`, of families that the localizer was not tuned on, 512 x 512 x 200
voxels in the good protocol. The bound is that of a homogeneous ball in white noise, so what posts, film and
streaks take is above it. `ronna-campaign localization` is the same on many more scans.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pydicom
from numpy.typing import NDArray

from benchmarks.contest import cpu_of
from benchmarks.figures import Figure, compared
from procedures.imaging import Localization, ThesisFit, Volume, localize, localize_as_thesis, read_series
from procedures.studies.phantom_scans import bound_mm
from ronna_hw.child_process import command

Array = NDArray[np.float64]
Method = Callable[[Volume], Localization]

SEEDS = (1001, 1002)
PHANTOM_LIMIT_S = 120.0
SAME_SPHERE_MM = 2.0
KIB_PER_GB = 1e9 / 1024.0
OURS, BARE_READ, READ, BOUND = "localize", "bare pydicom and stack", "read_series", "Cramér-Rao bound"
METHODS: dict[str, Method] = {
    OURS: localize,
    "thesis, LineFit": lambda volume: localize_as_thesis(volume, ThesisFit.LINE),
    "thesis, SphereFit": lambda volume: localize_as_thesis(volume, ThesisFit.SPHERE),
}
GOAL_CPU_S, GOAL_MEMORY_GB = 2.0, 1.2  # for 512 x 512 x 200, without reading the files


@dataclass(frozen=True)
class Case:
    """A family and a protocol, with the 3-D rms error to be reached."""

    family: str
    protocol: str
    goal_um: float

    @property
    def name(self) -> str:
        return f"CT {self.family}, {self.protocol}"


CASES = (
    Case("broad", "good", 10.0),
    Case("streaks", "good", 35.0),
    Case("narrow", "poor", 25.0),
    Case("streaks", "poor", 50.0),
)


@dataclass(frozen=True)
class Scan:
    """A series on disk and its truth."""

    series: Path
    centres_mm: Array
    bound_mm: float  # 3-D rms


def measure() -> list[Figure]:
    """Each scan is read barely, read with all checks, and localized by everybody, one after the other."""
    figures: list[Figure] = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            scans = [_scan(Path(folder) / str(seed), case, seed) for seed in SEEDS]
            figures += _figures(case, scans)
            if case is CASES[0]:
                figures.append(_memory(scans[0].series))
    return figures


def _figures(case: Case, scans: list[Scan]) -> list[Figure]:
    cpu_s: dict[str, list[float]] = {name: [] for name in (*METHODS, READ, BARE_READ)}
    squares: dict[str, list[float]] = {name: [] for name in METHODS}
    missed, false = dict.fromkeys(METHODS, 0), dict.fromkeys(METHODS, 0)
    _bare_read(scans[0].series)  # nobody pays for the decoders' first use
    for scan in scans:
        volumes: list[Volume] = []
        cpu_s[BARE_READ].append(cpu_of(lambda s=scan: _bare_read(s.series)))  # type: ignore[misc]
        cpu_s[READ].append(cpu_of(lambda s=scan, v=volumes: v.append(read_series(s.series))))  # type: ignore[misc]
        for name, method in METHODS.items():
            results: list[Localization] = []
            cpu_s[name].append(cpu_of(lambda m=method, v=volumes, r=results: r.append(m(v[0]))))  # type: ignore[misc]
            distance = np.linalg.norm(results[0].centres_mm[:, None] - scan.centres_mm[None], axis=2)
            missed[name] += int((distance.min(axis=0) > SAME_SPHERE_MM).sum())
            false[name] += int((distance.min(axis=1) > SAME_SPHERE_MM).sum())
            squares[name] += [float(d) ** 2 for d in distance.min(axis=0) if d <= SAME_SPHERE_MM]
    spheres = float(sum(len(scan.centres_mm) for scan in scans))
    limit_mm = math.sqrt(sum(scan.bound_mm**2 for scan in scans) / len(scans))
    figures = [
        _held(figure, GOAL_CPU_S) if figure.who == OURS else figure
        for figure in compared(f"CPU per series, {case.name}", "s", cpu_s, BARE_READ)
    ]
    for name in METHODS:
        rms_mm = math.sqrt(sum(squares[name]) / len(squares[name]))
        count = {"spheres": spheres, "missed": float(missed[name]), "false": float(false[name])}
        figure = Figure(
            f"3-D error rms, {case.name}", name, rms_mm * 1e3, "µm", rms_mm / limit_mm, BOUND, count
        )
        figures.append(_held(figure, case.goal_um) if name == OURS else figure)
    return [*figures, Figure(f"3-D error rms, {case.name}", BOUND, limit_mm * 1e3, "µm")]


def _held(figure: Figure, most: float) -> Figure:
    return replace(figure, goal=f"value ≤ {most:g}", met=figure.value <= most)


def _memory(series: Path) -> Figure:
    """Peak memory of the whole command."""
    child = subprocess.Popen(
        command("procedures.cli.ct", "localize", str(series), "--json"), stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"ronna-ct localize ended with {child.returncode}")
    figure = Figure("peak memory, 512 x 512 x 200", "ronna-ct localize", usage.ru_maxrss / KIB_PER_GB, "GB")
    return _held(figure, GOAL_MEMORY_GB)


def _scan(folder: Path, case: Case, seed: int) -> Scan:
    arguments = ["--out", str(folder), "--family", case.family, "--protocol", case.protocol]
    done = subprocess.run(
        command("sim.cli", "phantom", *arguments, "--seed", str(seed), "--json"),
        capture_output=True,
        text=True,
        timeout=PHANTOM_LIMIT_S,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(" ".join(done.stderr.split()))
    said = json.loads(done.stdout)
    truth = json.loads(Path(said["truth"]).read_text(encoding="utf-8"))
    centres = np.array([fiducial["centre_mm"] for fiducial in truth["fiducials"]])
    return Scan(Path(said["series"]), centres, bound_mm(truth))


def _bare_read(folder: Path) -> NDArray[np.int16]:
    slices = [pydicom.dcmread(path) for path in sorted(folder.iterdir())]
    slices.sort(key=lambda data: float(data.ImagePositionPatient[2]))
    return np.stack([data.pixel_array for data in slices]).astype(np.int16)
