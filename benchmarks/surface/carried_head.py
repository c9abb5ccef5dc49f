"""Registration that the clamp has carried, corrected by a few looks: how many looks suffice.

    python -m benchmarks.surface.carried_head --out benchmarks/results/surface-carried-2026-11-30/looks.json

Heads, misfit of the skin, error of the frame on the clamp and of the arm at each look are drawn by the seed.
The skin misses that of the CT alike in both scans. In half of the cases a third of the skin has moved by
1 mm on the head meanwhile. Judged is the movement of the head alone, at targets 30 to 60 mm deep.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.planning.skin_views import mark_scannable, spread_rows
from procedures.registration.surface.errors import CARRIED_DIFFERS
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.stations import Station, choose_stations
from procedures.steps.clinical.surface.carried_head import CarriedHead, correct_carried
from procedures.steps.clinical.surface.surface_paths import SEEN_MM
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.frames import Frame, Transform
from studies.surface.conditions import Draw, Skin
from studies.surface.heads import HeadInCt, draw_head
from studies.surface.skins import displace, shift_third

SEED, HEADS = 7801, 8
LOOKS, AGAIN = 14, (4, 6)
MISFIT = Draw(size_mm=0.3, length_mm=30.0, offset_sd_mm=0.0, offset_mm=0.0, noise_mm=0.05)
ARM_MM = 0.1  # per axis of a look
CLAMP_MM, CLAMP_RAD = 0.2, np.radians(0.1)  # per axis, of the frame's movement as the tracker tells it
BESIDE_MM = 3.0  # per axis of the skin: by which a look is repeated elsewhere
AWAY_MM, SHARE = 300.0, 0.6  # of the camera; and of the samples that one scan has
TARGETS = 5


def scan(
    in_ct: HeadInCt, middles_mm: Array, moved: Array, truth: Transform, random: np.random.Generator
) -> SurfaceScan:
    """Look at the skin around places (n, 3), displaced by `moved` (m,), of a head at a pose robot <- CT."""
    points, looks, views = [], [], []
    for number, middle_mm in enumerate(middles_mm):
        near = np.linalg.norm(in_ct.skin_mm - middle_mm, axis=1) < SEEN_MM
        rows = np.flatnonzero(near & (random.uniform(size=len(near)) < SHARE))
        outwards = in_ct.normals[rows]
        noise = MISFIT.noise_mm * random.normal(size=(len(rows), 3)) + ARM_MM * random.normal(size=3)
        points.append(truth.apply(in_ct.skin_mm[rows] + moved[rows, None] * outwards + noise))
        looks.append(np.full(len(rows), number))
        view = middle_mm + AWAY_MM * outwards.mean(axis=0)
        views.append(np.tile(truth.apply(view), (len(rows), 1)))
    look = np.concatenate(looks)
    covariance = np.tile(np.eye(3) * MISFIT.noise_mm**2, (len(look), 1, 1))
    return SurfaceScan(np.concatenate(points), covariance, look, look, np.concatenate(views))


def try_head(number: int) -> list[dict[str, Any]]:
    """Carry the registration of one head, and correct it by each number of looks."""
    random, in_ct = np.random.default_rng([SEED, number]), draw_head(SEED, number)
    targets_mm = np.concatenate(list(in_ct.targets_mm(random).values()))[:TARGETS]
    moved = displace(Skin.SMOOTH, in_ct.head, in_ct.skin_mm, MISFIT, random)
    shift = shift_third(in_ct.skin_mm[mark_scannable(in_ct)], random)
    slipped = moved.copy()
    slipped[mark_scannable(in_ct)] += shift
    places = in_ct.skin_mm[mark_scannable(in_ct)]
    middles = places[spread_rows(places, LOOKS)]
    first_pose = Transform(
        Frame.ROBOT,
        Frame.CT,
        RigidTransform.from_components(random.normal(size=3) * 300.0, Rotation.random(rng=random)),
    )
    first = scan(in_ct, middles, moved, first_pose, random)
    turn = Rotation.from_rotvec(random.normal(size=3) * CLAMP_RAD)
    error = RigidTransform.from_components(random.normal(size=3) * CLAMP_MM, turn)
    truth = Transform(Frame.ROBOT, Frame.CT, first_pose.rigid * error)  # elsewhere than carried by its error
    carried = CarriedHead("first", cast(Any, None), first, first_pose, 0.0)
    stations = []
    for middle in middles:
        near = np.linalg.norm(in_ct.skin_mm - middle, axis=1) < SEEN_MM
        stations.append(Station(in_ct.skin_mm[near], in_ct.normals[near], 1.0))
    best = choose_stations(stations, targets_mm, worth_mm_per_s=0.0).stations
    order = [*best, *(one for one in range(LOOKS) if one not in best)]
    uncorrected = np.linalg.norm(truth.apply(targets_mm) - first_pose.apply(targets_mm), axis=1)
    found = []
    for count in AGAIN:
        again = middles[order[:count]] + BESIDE_MM * random.normal(size=(count, 3))
        for name, now in (("stayed", moved), ("slipped", slipped)):
            seen = scan(in_ct, again, now, truth, random)
            row: dict[str, Any] = {
                "head": number,
                "looks": count,
                "skin": name,
                "uncorrected_mm": uncorrected.tolist(),
            }
            try:
                pose, errors = correct_carried(carried, seen, in_ct, targets_mm)
            except RonnaError as refusal:
                if not is_error(refusal, CARRIED_DIFFERS):
                    raise
                row["refusal"] = refusal.what
            else:
                off = np.linalg.norm(pose.apply(targets_mm) - truth.apply(targets_mm), axis=1)
                row |= {"error_mm": off.tolist(), "limit_mm": [one.limit_mm() for one in errors]}
            found.append(row)
    return found


def summarize(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Summarize by number of looks, and whether skin had moved on the head."""
    table = []
    for count in AGAIN:
        for name in ("stayed", "slipped"):
            own = [one for one in rows if (one["looks"], one["skin"]) == (count, name)]
            kept = [one for one in own if "refusal" not in one]
            error = np.array([value for one in kept for value in one["error_mm"]])
            limit = np.array([value for one in kept for value in one["limit_mm"]])
            before = np.array([value for one in own for value in one["uncorrected_mm"]])
            table.append(
                {
                    "looks": count,
                    "skin": name,
                    "cases": len(own),
                    "refused": len(own) - len(kept),
                    "uncorrected_rms_mm": float(np.sqrt(np.mean(before**2))),
                    "rms_mm": float(np.sqrt(np.mean(error**2))) if kept else None,
                    "largest_mm": float(error.max()) if kept else None,
                    "within_95": float(np.mean(error <= limit)) if kept else None,
                }
            )
    return table


def main() -> None:
    """Try all heads and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--heads", type=int, default=HEADS)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    rows = [
        row
        for number in range(arguments.first, arguments.first + arguments.heads)
        for row in try_head(number)
    ]
    table = summarize(rows)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(
        json.dumps({"seed": SEED, "heads": arguments.heads, "table": table}, indent=1) + "\n"
    )
    for one in table:
        print(one)


if __name__ == "__main__":
    main()
