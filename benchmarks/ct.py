"""Spheres in phantom scans: cost beside bare reading, error beside the Cramér-Rao bound.

The scans come from `ronna-sim phantom` with skull, posts, fillings, headrest, partial volume and noise. The
bound is that of a homogeneous ball in white noise, so what posts, film and streaks take is above it.
"""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray

from benchmarks.contest import cpu_of
from benchmarks.figures import Figure, compared
from procedures.imaging import Localization, Volume, localize, read_series
from ronna_hw.child_process import command

Array = NDArray[np.float64]

SCENES = {"default": (3, 4, 5, 6), "mini": (3, 4, 5, 6)}  # seeds; mini is the coarse protocol
PHANTOM_LIMIT_S = 60.0
SAME_SPHERE_MM = 2.0
AIR_HU = -1000.0
PLANE_BLUR_MM, SLICE_BLUR_MM = 0.42, 0.35  # what the phantom's scanner blurs, before the voxel's own size
BOX_VARIANCE = 1.0 / 12.0
LOCALIZE, READ, BARE_READ = "localize", "read_series", "bare pydicom and stack"
BOUND = "Cramér-Rao bound"


@dataclass(frozen=True)
class Scan:
    """A series on disk and its truth."""

    series: Path
    voxel_mm: tuple[float, ...]
    centres_mm: Array
    bound_mm: float  # 3-D rms


def measure() -> list[Figure]:
    """Both protocols; each scan is read barely, read with all checks, and localized, one after the other."""
    figures: list[Figure] = []
    for scene, seeds in SCENES.items():
        with tempfile.TemporaryDirectory() as folder:
            figures += _protocol(scene, [_scan(Path(folder) / str(seed), scene, seed) for seed in seeds])
    return figures


def _protocol(scene: str, scans: list[Scan]) -> list[Figure]:
    cpu_s: dict[str, list[float]] = {LOCALIZE: [], READ: [], BARE_READ: []}
    squares: list[float] = []
    missed = false = 0
    _bare_read(scans[0].series)  # nobody pays for the decoders' first use
    for scan in scans:
        volumes: list[Volume] = []
        results: list[Localization] = []
        cpu_s[BARE_READ].append(cpu_of(lambda s=scan: _bare_read(s.series)))  # type: ignore[misc]
        cpu_s[READ].append(cpu_of(lambda s=scan, v=volumes: v.append(read_series(s.series))))  # type: ignore[misc]
        cpu_s[LOCALIZE].append(cpu_of(lambda v=volumes, r=results: r.append(localize(v[0]))))  # type: ignore[misc]
        found = results[0].centres_mm
        distance = np.linalg.norm(found[:, None] - scan.centres_mm[None], axis=2)
        missed += int((distance.min(axis=0) > SAME_SPHERE_MM).sum())
        false += int((distance.min(axis=1) > SAME_SPHERE_MM).sum())
        squares += [float(d) ** 2 for d in distance.min(axis=0) if d <= SAME_SPHERE_MM]
    rms_mm = math.sqrt(sum(squares) / len(squares))
    bound_mm = math.sqrt(sum(scan.bound_mm**2 for scan in scans) / len(scans))
    sides = " x ".join(str(side) for side in scans[0].voxel_mm)
    name = f"CT {scene}, voxel {sides} mm"
    count = {"spheres": float(sum(len(s.centres_mm) for s in scans)), "missed": missed, "false": false}
    return [
        *compared(f"CPU per series, {name}", "s", cpu_s, BARE_READ),
        Figure(f"3-D error rms, {name}", LOCALIZE, rms_mm * 1e3, "µm", rms_mm / bound_mm, BOUND, count),
        Figure(f"3-D error rms, {name}", BOUND, bound_mm * 1e3, "µm"),
    ]


def _scan(folder: Path, scene: str, seed: int) -> Scan:
    arguments = ["--out", str(folder), "--scene", scene, "--seed", str(seed), "--json"]
    done = subprocess.run(
        command("sim.cli", "phantom", *arguments),
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
    return Scan(Path(said["series"]), tuple(truth["voxel_mm"]), centres, _bound_mm(truth))


def _bound_mm(truth: dict[str, Any]) -> float:
    """3-D rms of the bound for a homogeneous ball, isotropic blur s, voxel volume v, contrast C, white noise.

    sigma_x = (sigma / C) sqrt(v 2 sqrt(pi) s 3 / (4 pi R^2)) per axis.
    """
    pixel, _, slice_mm = truth["voxel_mm"]
    plane = PLANE_BLUR_MM**2 + BOX_VARIANCE * pixel**2
    along = SLICE_BLUR_MM**2 + BOX_VARIANCE * slice_mm**2
    blur_mm = math.sqrt((2.0 * plane + along) / 3.0)
    variances = []
    for fiducial in truth["fiducials"]:
        contrast, radius = fiducial["HU"] - AIR_HU, fiducial["radius_mm"]
        volume = pixel * pixel * slice_mm
        area = 3.0 / (4.0 * math.pi * radius**2)
        axis = (truth["noise_HU"] / contrast) ** 2 * volume * 2.0 * math.sqrt(math.pi) * blur_mm * area
        variances.append(3.0 * axis)
    return math.sqrt(sum(variances) / len(variances))


def _bare_read(folder: Path) -> NDArray[np.int16]:
    slices = [pydicom.dcmread(path) for path in sorted(folder.iterdir())]
    slices.sort(key=lambda data: float(data.ImagePositionPatient[2]))
    return np.stack([data.pixel_array for data in slices]).astype(np.int16)
