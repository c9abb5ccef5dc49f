"""Registration that starts from the scan alone: how many heads are found, how far off, how long it takes.

    python -m benchmarks.surface.global_start --out heads.json

Heads, misfit of the skin and poses in the room are drawn by the seed, over all turns alike. The kinds of
misfit are those of development in turn: the judged ones are not touched. Each head is scanned from the
front, with the ears, and from all sides. A registration whose head is further than `FOUND_MM` from the
truth anywhere is a wrong pose.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from procedures.registration.surface.surface_registration import SurfaceRegistration, register_surface
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from studies.surface.conditions import DEVELOPMENT, Coverage, Draw
from studies.surface.heads import draw_head
from studies.surface.scanning import draw_trial

SEED, HEADS = 7950, 50
SCANNED = (Coverage.FRONT_AND_EARS, Coverage.ALL)
FOUND_MM = 10.0  # skin that is further off than this was put there by another pose, not by a misfit


def try_head(number: int, coverage: Coverage) -> dict[str, Any]:
    """Register a scan of one head without a start."""
    random = np.random.default_rng([SEED, number, SCANNED.index(coverage)])
    skin = DEVELOPMENT[number % len(DEVELOPMENT)]
    draw = Draw.of(random)
    head = draw_head(SEED, number)
    targets_mm = np.concatenate(list(head.targets_mm(random).values()))
    trial = draw_trial(head, coverage, skin, draw, random, shifted=False)
    in_ct = head.shown_by(draw.offset_mm, trial.slices)
    row: dict[str, Any] = {"head": number, "scanned": coverage.value, "skin": skin.value}
    began_s = time.process_time()
    try:
        found = register_surface(trial.scan, in_ct, targets_ct_mm=targets_mm)
    except RonnaError as refusal:
        row["refused"] = refusal.code
    else:
        row |= judge(found, trial.truth, in_ct.points_mm, targets_mm)
    return row | {"processor_s": time.process_time() - began_s}


def judge(found: SurfaceRegistration, truth: Transform, skin_mm: Array, targets_mm: Array) -> dict[str, Any]:
    """Compare a registration with the truth, at the skin of the head and at targets (m, 3)."""
    here, there = found.robot_from_ct.apply(skin_mm), truth.apply(skin_mm)
    errors_mm = np.linalg.norm(found.robot_from_ct.apply(targets_mm) - truth.apply(targets_mm), axis=1)
    return {
        "skin_off_mm": float(np.linalg.norm(here - there, axis=1).max()),
        "errors_mm": errors_mm.tolist(),
        "limits_mm": [found.predict(one).limit_mm() for one in targets_mm],
        "side_proven": found.side_proven,
    }


def summarize(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Summarize by what was scanned."""
    table = []
    for coverage in SCANNED:
        own = [one for one in rows if one["scanned"] == coverage.value]
        kept = [one for one in own if "refused" not in one]
        found = [one for one in kept if one["skin_off_mm"] < FOUND_MM]
        errors = np.array([value for one in found for value in one["errors_mm"]])
        limits = np.array([value for one in found for value in one["limits_mm"]])
        seconds = [one["processor_s"] for one in own]
        table.append(
            {
                "scanned": coverage.value,
                "heads": len(own),
                "found": len(found),
                "wrong_pose": len(kept) - len(found),
                "refused": sorted(one["refused"] for one in own if "refused" in one),
                "farthest_skin_mm": max(one["skin_off_mm"] for one in kept),
                "mean_mm": float(errors.mean()),
                "largest_mm": float(errors.max()),
                "within_limit": float(np.mean(errors <= limits)),
                "side_proven": sum(one["side_proven"] for one in found),
                "median_s": float(np.median(seconds)),
                "longest_s": max(seconds),
            }
        )
    return table


def main() -> None:
    """Try all heads and write the table with every head."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--heads", type=int, default=HEADS)
    arguments = parser.parse_args()
    rows = [try_head(number, one) for number in range(arguments.heads) for one in SCANNED]
    table = summarize(rows)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    kept = {"seed": SEED, "heads": arguments.heads, "table": table, "rows": rows}
    arguments.out.write_text(json.dumps(kept, indent=1) + "\n")
    for one in table:
        print(one)


if __name__ == "__main__":
    main()
