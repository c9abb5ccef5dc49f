"""Error of a registration on the skin with none to three screws, on heads and skins of the surface study.

    python -m benchmarks.surface.screws_beside_skin --out RESULT.json

Of the same scans, each with the next screw: rms error at the study's targets, what was predicted, targets
within their limit, refusals; then with the first sphere displaced: how often it is named. The arm has no
errors here.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from procedures.registration.surface.spheres import LookedSpheres
from procedures.registration.surface.surface_registration import register_surface
from ronna_hw.arrays import Array
from ronna_hw.errors import RefusedError
from studies.campaign.study import Unit
from studies.surface.conditions import SECOND_JUDGED, THIRD_JUDGED, Coverage
from studies.surface.scanning import Trial
from studies.surface.study import draw_unit

# Frozen before the run; no other was looked at. The kinds that judged first set what the skin may hide.
SEED, HEADS, KINDS = 4401, 4, (*SECOND_JUDGED, *THIRD_JUDGED)
COUNTS = (0, 1, 2, 3)
SPHERE_SD_MM = 0.1  # per axis: CT, seating and look
STANDOFF_MM = 16.0  # of a sphere's centre from the skin
# Of the screws from the middle of the head, LPS: high on the forehead, and behind it on both sides.
DIRECTIONS = np.array([[0.35, -0.6, 0.72], [-0.6, 0.1, 0.8], [0.55, 0.25, 0.8]])
MOVED_MM = (1.0, 2.0)


def main() -> None:
    """Run all conditions and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    by_count: dict[int, list[tuple[float, float, float]]] = {count: [] for count in COUNTS}
    refused: dict[int, dict[str, int]] = {count: {} for count in COUNTS}
    named = {f"{count} screws, {moved_mm:g} mm": [0, 0] for count in COUNTS[1:] for moved_mm in MOVED_MM}
    for head in range(HEADS):
        for skin in KINDS:
            unit = Unit(f"{Coverage.FRONT_AND_EARS}|{skin}", head, 1)
            in_ct, trial, draw = draw_unit(SEED, unit)
            surface = in_ct.shown_by(draw.offset_mm, trial.slices)
            random = np.random.default_rng((SEED, head, *skin.encode()))
            targets = np.concatenate(list(in_ct.targets_mm(random).values()))
            screws = _place_screws(surface.points_mm, surface.normals)
            errors = SPHERE_SD_MM * random.normal(size=screws.shape)
            for count in COUNTS:
                try:
                    found = register_surface(
                        trial.scan, surface, trial.start, spheres=_look(trial, screws[:count], errors[:count])
                    )
                except RefusedError as error:
                    refused[count][error.code] = refused[count].get(error.code, 0) + 1
                    continue
                away = np.linalg.norm(found.robot_from_ct.apply(targets) - trial.truth.apply(targets), axis=1)
                for target, mm in zip(targets, away.tolist(), strict=True):
                    predicted = found.predict(target)
                    by_count[count].append((mm, predicted.rms_mm, predicted.limit_mm()))
                for moved_mm in MOVED_MM if count else ():
                    counted = named[f"{count} screws, {moved_mm:g} mm"]
                    counted[1] += 1
                    moved = errors[:count].copy()
                    moved[0] += moved_mm * _direction(random)
                    try:
                        looks = _look(trial, screws[:count], moved)
                        register_surface(trial.scan, surface, trial.start, spheres=looks)
                    except RefusedError as error:
                        counted[0] += error.code == "SRF-012" and "sphere 1 " in error.what
    out.write_text(json.dumps(_tables(by_count, refused, named), indent=1) + "\n")


def _tables(
    by_count: dict[int, list[tuple[float, float, float]]],
    refused: dict[int, dict[str, int]],
    named: dict[str, list[int]],
) -> dict[str, object]:
    rows = {}
    for count, values in by_count.items():
        error, rms, limit = np.array(values).T
        rows[str(count)] = {
            "rms_mm": float(np.sqrt(np.mean(error**2))),
            "mean_mm": float(error.mean()),
            "predicted_rms_mm": float(np.sqrt(np.mean(rms**2))),
            "within_limit_percent": float(100.0 * np.mean(error <= limit)),
            "targets": len(error),
            "refused": refused[count],
        }
    shown = {name: {"named": found, "of": tried} for name, (found, tried) in named.items()}
    return {"seed": SEED, "heads": HEADS, "by_screws": rows, "first_sphere_displaced": shown}


def _place_screws(skin_mm: Array, normals: Array) -> Array:
    middle = skin_mm.mean(axis=0)
    towards = skin_mm - middle
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    rows = (DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)) @ towards.T
    nearest = rows.argmax(axis=1)
    return np.asarray(skin_mm[nearest] + STANDOFF_MM * normals[nearest])


def _look(trial: Trial, screws: Array, errors: Array) -> LookedSpheres:
    count = len(screws)
    there = trial.truth.apply(screws + errors) if count else screws
    return LookedSpheres(np.arange(count), screws, there, np.eye(3 * count) * SPHERE_SD_MM**2)


def _direction(random: np.random.Generator) -> Array:
    drawn = random.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


if __name__ == "__main__":
    main()
