"""Phantom scans with ground truth for the localization study, made by `ronna-sim phantom`."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.imaging import Volume, read_series
from ronna_hw.host.child_process import command, run_command
from studies.errors import PhantomFailed

Array = NDArray[np.float64]

PHANTOM_LIMIT_S = 300.0  # host time, as a safeguard
AIR_HU = -1000.0
PLANE_BLUR_MM, SLICE_BLUR_MM = 0.42, 0.35  # blur of the phantom's scanner, excluding the voxel size
BOX_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, eq=False)
class PhantomScan:
    """A volume and its spheres: centres (n, 3) LPS mm, and whether each is fully in the field of view.

    `objects` that are no markers but resemble them are beside these.
    """

    volume: Volume
    centres_mm: Array
    whole: NDArray[np.bool_]
    purpose: str
    bound_mm: float  # Cramér-Rao, 3-D rms over the spheres
    objects: int = 0


@contextmanager
def phantom_scan(
    family: str, protocol: str, seed: int, fiducials: str = "free", markers: int | None = None
) -> Iterator[PhantomScan]:
    """Make a scan; its files are deleted afterwards. Raises STU-006."""
    with tempfile.TemporaryDirectory() as folder:
        series, truth = scan_phantom(Path(folder), family, protocol, seed, fiducials, markers)
        yield PhantomScan(
            read_series(series),
            np.array([fiducial["centre_mm"] for fiducial in truth["fiducials"]]),
            np.array([fiducial.get("surface_in_field", 1.0) == 1.0 for fiducial in truth["fiducials"]]),
            truth["purpose"],
            bound_mm(truth),
            len(truth.get("look_alikes", ())) + len(truth.get("distractors_mm", ())),
        )


def scan_phantom(
    folder: Path, family: str, protocol: str, seed: int, fiducials: str = "free", markers: int | None = None
) -> tuple[Path, dict[str, Any]]:
    """Write a scan into the folder: its series and its truth. Raises STU-006."""
    arguments = ["--family", family, "--protocol", protocol, "--fiducials", fiducials]
    arguments += [] if markers is None else ["--markers", str(markers)]
    words = command("sim.cli", "phantom", "--out", str(folder), "--seed", str(seed), "--json", *arguments)
    done = run_command("ronna-sim phantom", words, PHANTOM_LIMIT_S)
    if done.returncode != 0:
        raise PhantomFailed(f"{family}, {protocol}, seed {seed}", got=" ".join(done.stderr.split()))
    announcement = json.loads(done.stdout)
    return Path(announcement["series"]), json.loads(Path(announcement["truth"]).read_text(encoding="utf-8"))


def bound_mm(truth: dict[str, Any]) -> float:
    """Return Cramér-Rao bound, 3-D rms, of a homogeneous ball in white noise.

    sigma_x = (sigma / C) sqrt(v 2 sqrt(pi) s 3 / (4 pi R^2)) per axis, for noise sigma, contrast C, voxel
    volume v, isotropic blur s and radius R.
    """
    pixel, _, slice_mm = truth["voxel_mm"]
    plane = PLANE_BLUR_MM**2 + BOX_VARIANCE * pixel**2
    along = SLICE_BLUR_MM**2 + BOX_VARIANCE * slice_mm**2
    blur_mm = sqrt((2.0 * plane + along) / 3.0)
    variances = []
    for fiducial in truth["fiducials"]:
        contrast, radius = fiducial["HU"] - AIR_HU, fiducial["radius_mm"]
        area = 3.0 / (4.0 * pi * radius**2)
        volume = pixel * pixel * slice_mm
        axis = (truth["noise_HU"] / contrast) ** 2 * volume * 2.0 * sqrt(pi) * blur_mm * area
        variances.append(3.0 * axis)
    return sqrt(sum(variances) / len(variances))
