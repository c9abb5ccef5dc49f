"""Spheres on metal screws, whose shadows and streaks come from the physics of the scan.

A sphere is found, listed as doubtful with its picture, or missed. Errors are reported apart for spheres with
and without streaks through them, by what the scanner itself added inside the sphere.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from procedures.imaging import Volume, localize, read_series
from procedures.imaging.errors import MarkerCountWrong
from procedures.imaging.markers import Candidate, Marker
from ronna_hw.arrays import Array
from studies.campaign.study import (
    GOALS,
    Cell,
    Study,
    Sums,
    Table,
    Unit,
    as_sums,
    blocks_of_each,
    generator,
    judge,
    judge_at_least,
    judge_at_most,
    judge_within,
    pool,
)
from studies.localization.phantom_scans import scan_phantom
from studies.localization.study import CHI2_AT_TAIL, SAME_SPHERE_MM, SEED_BOUND

FAMILY = "metal"
PROTOCOLS = ("fine", "good", "usual")  # 0.45 to 0.6 mm pixels, slices of 0.6 to 1.25 mm
STREAKED_HU = 50.0  # rms inside the sphere, 5 % of its contrast
KINDS = ("without", "with")
RMS_UM = {"without": 15.0, "with": 40.0}
CHI2 = (0.7, 1.4)
LEAST_SPHERES = 300


@dataclass(frozen=True)
class MetalStudy(Study):
    """Localization of spheres on metal, by number of volumes per protocol."""

    volumes: int
    seed: int = 0
    name: str = "localization-metal"

    def units(self) -> Sequence[Unit]:
        return blocks_of_each(([protocol] for protocol in PROTOCOLS), self.volumes, 1)

    def run(self, unit: Unit) -> Sums:
        """Return the counts and sums of squares (mm2) of one volume."""
        seed = int(generator(self.seed, unit).integers(SEED_BOUND))
        with tempfile.TemporaryDirectory() as folder:
            series, truth = scan_phantom(Path(folder), FAMILY, unit.condition, seed)
            markers, candidates = localize_all(read_series(series))
        centres = np.array([fiducial["centre_mm"] for fiducial in truth["fiducials"]])
        streaked = np.array([fiducial["streak_HU"] > STREAKED_HU for fiducial in truth["fiducials"]])
        return count_spheres(markers, candidates, centres, streaked)


def localize_all(volume: Volume) -> tuple[Sequence[Marker], Sequence[Candidate]]:
    """Return the markers and all candidates of a volume, even if there is no marker."""
    try:
        result = localize(volume)
    except MarkerCountWrong as wrong:
        return (), wrong.candidates
    return result.markers, result.candidates


def count_spheres(
    markers: Sequence[Marker],
    candidates: Sequence[Candidate],
    centres_mm: Array,
    streaked: NDArray[np.bool_],
) -> Sums:
    """Count spheres at `centres_mm` (n, 3) by kind: found with their errors, doubtful, missed, false."""
    found = np.array([marker.centre_mm for marker in markers]).reshape(-1, 3)
    doubtful = np.array([one.centre_mm for one in candidates if one.doubtful]).reshape(-1, 3)
    distance, in_doubt = (
        np.linalg.norm(places[:, None] - centres_mm[None], axis=2) for places in (found, doubtful)
    )
    sums: dict[str, float] = defaultdict(float, volumes=1.0)
    sums["false"] = len(found) - int((distance < SAME_SPHERE_MM).any(axis=0).sum())
    sums["other doubtful"] = int((in_doubt.min(axis=1, initial=np.inf) >= SAME_SPHERE_MM).sum())
    for sphere, centre in enumerate(centres_mm):
        kind = KINDS[int(streaked[sphere])]
        sums[f"{kind}|spheres"] += 1
        if distance[:, sphere].min(initial=np.inf) >= SAME_SPHERE_MM:
            listed = in_doubt[:, sphere].min(initial=np.inf) < SAME_SPHERE_MM
            sums[f"{kind}|doubtful" if listed else f"{kind}|missed"] += 1
            continue
        marker = markers[int(distance[:, sphere].argmin())]
        error = np.array(marker.centre_mm) - centre
        chi2 = float(error @ np.linalg.solve(marker.covariance_mm2, error))
        sums[f"{kind}|found"] += 1
        sums[f"{kind}|error2"] += float(error @ error)
        sums[f"{kind}|chi2"] += chi2
        sums[f"{kind}|tail"] += chi2 > CHI2_AT_TAIL
    return as_sums(sums)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the results by protocol and together, and compare them with the goals."""
    streaks = f"Streaks: metal artefacts of more than {STREAKED_HU:g} HU rms inside the sphere."
    return tabulate_spheres("Spheres on metal screws", "protocol", streaks, sums)


def tabulate_spheres(title: str, condition: str, streaks: str, sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the sums of `count_spheres` by condition and together, and compare them with the goals."""
    together = pool(sums.values())
    rows = [
        {condition: name, **_make_row(kind, total)}
        for name, total in [*sums.items(), ("all", together)]
        for kind in KINDS
        if total.get(f"{kind}|spheres")
    ]
    return [
        Table.of(
            title,
            rows,
            f"{streaks} Errors are 3-D. chi² / 3n is 1 when the stated covariances are right. A doubtful "
            "sphere is listed with its picture and odds; a missed one is not listed.",
        ),
        Table("Goals", GOALS, _judge(together)),
    ]


def _make_row(kind: str, total: Mapping[str, float]) -> dict[str, Cell]:
    found = total.get(f"{kind}|found", 0.0)
    return {
        "streaks": kind,
        **{
            what: int(total.get(f"{kind}|{what}", 0.0)) for what in ("spheres", "found", "doubtful", "missed")
        },
        "rms µm": 1e3 * sqrt(total[f"{kind}|error2"] / found) if found else None,
        "chi² / 3n": total[f"{kind}|chi2"] / (3.0 * found) if found else None,
        "outside 99 %": int(total.get(f"{kind}|tail", 0.0)),
        "false": int(total.get("false", 0.0)),
        "other doubtful": int(total.get("other doubtful", 0.0)),
    }


def _judge(total: Mapping[str, float]) -> list[Sequence[Cell]]:
    spheres, missed, doubtful, found, chi2 = (
        sum(total.get(f"{kind}|{what}", 0.0) for kind in KINDS)
        for what in ("spheres", "missed", "doubtful", "found", "chi2")
    )
    false = total.get("false", 0.0)
    rows = [
        judge_at_least("spheres", int(spheres), LEAST_SPHERES),
        judge("missed: not even listed", int(missed), "0", missed == 0),
        judge("doubtful: listed, not counted", int(doubtful), "0", doubtful == 0),
        judge("false", int(false), "0", false == 0),
    ]
    for kind, most_um in RMS_UM.items():
        if count := total.get(f"{kind}|found", 0.0):
            rms_um = 1e3 * sqrt(total[f"{kind}|error2"] / count)
            rows.append(judge_at_most(f"rms µm, {kind} streaks", rms_um, most_um))
    if found:
        rows.append(judge_within("chi² / 3n", chi2 / (3.0 * found), CHI2))
    return rows
