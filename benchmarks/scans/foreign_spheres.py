"""Marker spheres in scans by X-ray software that shares nothing with our phantom.

    python -m benchmarks.scans.foreign_spheres FOLDER [--keep OUT]

FOLDER holds scans by `benchmarks/peers/xray_scanner.py`, which says what is in them; its families are frozen.
Prints a row per family, kept with every sphere in OUT. A sphere is found, listed as doubtful, or unlisted:
missed without a word to the operator. Metal posts make the streaks.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from procedures.imaging import Volume, VoxelGeometry
from ronna_hw.arrays import Array
from studies.localization.metal_study import CHI2, LEAST_SPHERES, RMS_UM, localize_all
from studies.localization.study import CHI2_AT_TAIL, SAME_SPHERE_MM

WITHOUT_METAL = ("polymer", "coarse")
MOST_UNLISTED, MOST_FALSE = 3, 0
FOUND, DOUBTFUL, UNLISTED = "found", "doubtful", "unlisted"
STREAKS = ("without", "with")


@dataclass(frozen=True)
class Sphere:
    """One true sphere, how it was answered, and the error of a found one with its normalized square."""

    scan: str
    number: int
    outcome: str
    error_um: float | None = None
    chi2: float | None = None
    flags: str = ""

    @property
    def streaks(self) -> str:
        return STREAKS[self.family not in WITHOUT_METAL]

    @property
    def family(self) -> str:
        return self.scan.rpartition("-")[0]


@dataclass(frozen=True)
class JudgedScan:
    """The spheres of a scan, and how many other places were taken for markers or doubted."""

    name: str
    spheres: tuple[Sphere, ...]
    false: int
    other_doubtful: int


def read_volume(hu: Any, spacing_mm: Array) -> Volume:
    """Return voxels (z, y, x) as a volume whose L, P, S are x, y and z from the isocentre."""
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    origin = -0.5 * (np.array(hu.shape) - 1.0) * spacing_mm
    voxels = np.ascontiguousarray(hu)
    voxels.flags.writeable = False
    return Volume(voxels, VoxelGeometry(hu.shape, origin[::-1].copy(), axes, spacing_mm), "1.2.3", "1.2.4")


def judge_scan(name: str, volume: Volume, centres_mm: Array) -> JudgedScan:
    markers, candidates = localize_all(volume)
    found = np.array([marker.centre_mm for marker in markers]).reshape(-1, 3)
    doubted = np.array([one.centre_mm for one in candidates if one.doubtful]).reshape(-1, 3)
    apart, in_doubt = (
        np.linalg.norm(places[:, None] - centres_mm[None], axis=2) for places in (found, doubted)
    )
    spheres = []
    for number, centre in enumerate(centres_mm):
        if apart[:, number].min(initial=math.inf) >= SAME_SPHERE_MM:
            is_listed = in_doubt[:, number].min(initial=math.inf) < SAME_SPHERE_MM
            spheres.append(Sphere(name, number, DOUBTFUL if is_listed else UNLISTED))
            continue
        marker = markers[int(apart[:, number].argmin())]
        error = np.array(marker.centre_mm) - centre
        chi2 = float(error @ np.linalg.solve(marker.covariance_mm2, error))
        length_um = 1e3 * float(np.linalg.norm(error))
        spheres.append(Sphere(name, number, FOUND, length_um, chi2, " ".join(marker.flags)))
    false = len(found) - int((apart < SAME_SPHERE_MM).any(axis=0).sum())
    other = int((in_doubt.min(axis=1, initial=math.inf) >= SAME_SPHERE_MM).sum())
    return JudgedScan(name, tuple(spheres), false, other)


def judge_folder(folder: Path) -> Iterator[JudgedScan]:
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as scan:
            volume = read_volume(scan["hu"], scan["spacing_mm"])
            yield judge_scan(path.stem, volume, scan["centres_mm"])


def summarize(spheres: Sequence[Sphere]) -> dict[str, float | int | None]:
    outcomes = [sphere.outcome for sphere in spheres]
    errors = np.array([sphere.error_um for sphere in spheres if sphere.error_um is not None])
    chi2 = np.array([sphere.chi2 for sphere in spheres if sphere.chi2 is not None])
    return {
        "spheres": len(spheres),
        **{outcome: outcomes.count(outcome) for outcome in (FOUND, DOUBTFUL, UNLISTED)},
        "rms_um": float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
        "largest_um": float(errors.max()) if len(errors) else None,
        "normalized_square": float(chi2.mean()) / 3.0 if len(chi2) else None,
        "outside_99_percent": int((chi2 > CHI2_AT_TAIL).sum()),
    }


def tabulate(scans: Sequence[JudgedScan]) -> dict[str, Any]:
    """Return figures by family, by streaks and of all, with what was asked and whether it was reached."""
    spheres = [sphere for scan in scans for sphere in scan.spheres]
    families = dict.fromkeys(sphere.family for sphere in spheres)
    figures: dict[str, Any] = {
        "families": {
            family: summarize([one for one in spheres if one.family == family])
            | {"false": sum(scan.false for scan in scans if scan.spheres[0].family == family)}
            for family in families
        },
        "streaks": {kind: summarize([one for one in spheres if one.streaks == kind]) for kind in STREAKS},
        "all": summarize(spheres)
        | {
            "false": sum(scan.false for scan in scans),
            "other_doubtful": sum(scan.other_doubtful for scan in scans),
            "scans": len(scans),
        },
    }
    total, kinds = figures["all"], figures["streaks"]
    figures["reached"] = {
        "spheres": total["spheres"] >= LEAST_SPHERES,
        "unlisted": total[UNLISTED] <= MOST_UNLISTED,
        "false": total["false"] <= MOST_FALSE,
        **{
            f"rms_{kind}": kinds[kind]["rms_um"] <= most
            for kind, most in RMS_UM.items()
            if kinds[kind]["rms_um"] is not None  # not judged without any
        },
        "normalized_square": CHI2[0] <= (total["normalized_square"] or math.inf) <= CHI2[1],
    }
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for figures.json and spheres.csv")
    options = parser.parse_args()
    scans = list(judge_folder(options.folder))
    figures = tabulate(scans)
    for name, row in [*figures["families"].items(), *figures["streaks"].items(), ("all", figures["all"])]:
        print(f"{name:10}", *(f"{key} {value:.3g}" for key, value in row.items() if value is not None))
    print("reached:", figures["reached"])
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
        (options.keep / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
        with (options.keep / "spheres.csv").open("w", newline="") as stream:
            rows = [asdict(sphere) for scan in scans for sphere in scan.spheres]
            writer = csv.DictWriter(stream, list(rows[0]))
            writer.writeheader()
            writer.writerows(
                {key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()}
                for row in rows
            )


if __name__ == "__main__":
    main()
