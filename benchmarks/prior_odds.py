"""How the answers of the correspondence depend on the two odds that are assumed beforehand.

    .venv/bin/python -P benchmarks/prior_odds.py --runs 100 --seed 1

The same readings of the thesis' protocol are solved with every setting. False answers are too rare for a few
thousand runs, and nearly all are strays that pair by chance; so their share is also measured with two strays
laid near each other, weighted by how seldom that happens (a little too often, for strays at the edge of the
room they are drawn in). Prints one Markdown table.
"""

from __future__ import annotations

import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import product, repeat
from typing import Annotated

import numpy as np
import typer

from procedures.registration.correspondence_search import CorrespondenceSearch
from procedures.registration.hypotheses import PAIR_ODDS, WIDE_SET_ODDS, Evidence
from procedures.studies.correspondence import FALSE, OUTLIERS, UNSUCCESSFUL, verdict
from procedures.studies.heads import (
    IMAGE_SIGMA_MM,
    OUTLIER_BALL_MM,
    PATIENTS,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    in_balls,
    per_axis_mm,
    sites_mm,
)
from procedures.studies.readings import Readings, draw_readings

Setting = tuple[float, float]  # odds of a pair, odds of a set that is wider than a head
Cell = tuple[NoiseReading, int, int, int]  # reading of the noise, patient, fiducials, outliers

SETTINGS: tuple[Setting, ...] = (
    *((odds, WIDE_SET_ODDS) for odds in (1.0, 3.0, PAIR_ODDS, 30.0)),
    *((PAIR_ODDS, odds) for odds in (1.0, 1e-5)),
)
GROUPS = {"3": (3,), "4": (4,), "5 to 8": (5, 6, 7, 8)}
NEAR_FIDUCIALS, NEAR_STRAYS = 5, 4
NEAR_MM = 15.0  # two strays farther from agreement never pair with five fiducials

app = typer.Typer(add_completion=False, rich_markup_mode=None)


def solve(cell: Cell, runs: int, seed: int) -> Counter[tuple[Setting, str]]:
    """Outcomes of all settings on the readings of one cell."""
    noise, patient, count, outliers = cell
    random = _random(cell, seed)
    return _outcomes(draw_readings(sites_mm(patient), count, outliers, noise, runs, random), noise)


def solve_near(noise: NoiseReading, patient: int, runs: int, seed: int) -> Counter[tuple[Setting, str]]:
    """Outcomes where one stray of the room lies near the place of one of the CT."""
    random = _random((noise, patient, NEAR_FIDUCIALS, NEAR_STRAYS), seed + 1)
    seen = draw_readings(sites_mm(patient), NEAR_FIDUCIALS, NEAR_STRAYS, noise, runs, random)
    every = np.arange(NEAR_FIDUCIALS + NEAR_STRAYS)
    for run, (pairs, turn) in enumerate(zip(seen.pairs, seen.rotations.as_matrix(), strict=True)):
        image, physical = seen.image_mm[run], seen.physical_mm[run]
        in_ct, in_room = (np.setdiff1d(every, pairs[:, side])[0] for side in (0, 1))
        shift = (physical[pairs[:, 1]] - image[pairs[:, 0]] @ turn.T).mean(axis=0)
        physical[in_room] = turn @ image[in_ct] + shift + in_balls(1, NEAR_MM, random)[0]
    return _outcomes(seen, noise)


def _random(cell: Cell, seed: int) -> np.random.Generator:
    noise, *numbers = cell
    return np.random.default_rng([seed, list(NoiseReading).index(noise), *numbers])


def _outcomes(seen: Readings, noise: NoiseReading) -> Counter[tuple[Setting, str]]:
    variance_mm2 = math.fsum(per_axis_mm(one, noise) ** 2 for one in (IMAGE_SIGMA_MM, PHYSICAL_SIGMA_MM))
    outcomes: Counter[tuple[Setting, str]] = Counter()
    for run, pairs in enumerate(seen.pairs.tolist()):
        right = frozenset((i, j) for i, j in pairs)
        for setting in SETTINGS:
            evidence = Evidence(variance_mm2, *setting)
            found = CorrespondenceSearch(
                seen.image_mm[run], seen.physical_mm[run], evidence, None, None
            ).answer()
            outcomes[setting, verdict(found.status, found.pairs, right)] += 1
    return outcomes


@app.command()
def main(
    runs: Annotated[int, typer.Option(min=1, help="Per patient and cell of the protocol.")] = 100,
    near: Annotated[int, typer.Option(min=1, help="Per patient, with two strays near each other.")] = 1000,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes [one per core].")] = None,
) -> None:
    """Unsuccessful and false shares against the odds."""
    cells = list(product(NoiseReading, PATIENTS, range(3, 9), OUTLIERS))
    nears = list(product(NoiseReading, PATIENTS))
    with ProcessPoolExecutor(workers) as pool:
        found = dict(zip(cells, pool.map(solve, cells, repeat(runs), repeat(seed)), strict=True))
        of_near = pool.map(solve_near, *zip(*nears, strict=True), repeat(near), repeat(seed))
        beside = dict(zip(nears, of_near, strict=True))
    columns = ("noise", "odds of a pair", "of a wide set", *GROUPS, f"{NEAR_FIDUCIALS}, false by weight")
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    # Of the pairs that the strays can form, each has this chance to lie as near in the protocol.
    weight = 100.0 * NEAR_STRAYS**2 * (NEAR_MM / OUTLIER_BALL_MM) ** 3
    for noise, setting in product(NoiseReading, SETTINGS):
        shares = []
        for counts in GROUPS.values():
            group = [found[cell] for cell in cells if cell[0] is noise and cell[2] in counts]
            lost, false = (sum(one[setting, what] for one in group) for what in (UNSUCCESSFUL, FALSE))
            percent = 100.0 / (runs * len(group))
            shares.append(f"{lost * percent:.3f} / {false * percent:.3f}")
        near_false = sum(beside[noise, patient][setting, FALSE] for patient in PATIENTS)
        shares.append(f"{weight * near_false / (near * len(PATIENTS)):.4f}")
        lines.append(f"| {noise.value} | {setting[0]:g} | {setting[1]:g} | {' | '.join(shares)} |")
    typer.echo("\n".join(lines))


if __name__ == "__main__":
    app()
