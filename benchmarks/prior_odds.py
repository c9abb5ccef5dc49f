"""How the answers of the correspondence depend on the two odds that are assumed beforehand.

    .venv/bin/python -P benchmarks/prior_odds.py --runs 1000 --seed 1

The same readings of the thesis' protocol are solved with every setting. Prints one Markdown table.
"""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.append(str(ROOT))  # benchmarks are not installed; our packages are

from procedures.registration.hypotheses import PAIR_ODDS, WIDE_SET_ODDS, Evidence  # noqa: E402
from procedures.registration.pairing_search import PairingSearch  # noqa: E402
from procedures.studies.correspondence import FALSE, OUTLIERS, UNSUCCESSFUL, verdict  # noqa: E402
from procedures.studies.heads import (  # noqa: E402
    IMAGE_SIGMA_MM,
    PATIENTS,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    per_axis_mm,
    sites_mm,
)
from procedures.studies.readings import draw_readings  # noqa: E402

Setting = tuple[float, float]  # odds of a pair, odds of a set that is wider than a head
Cell = tuple[NoiseReading, int, int, int]  # reading of the noise, patient, fiducials, outliers

SETTINGS: tuple[Setting, ...] = (
    *((odds, WIDE_SET_ODDS) for odds in (1.0, 3.0, PAIR_ODDS, 30.0, 100.0)),
    *((PAIR_ODDS, odds) for odds in (1.0, 1e-2, 1e-4)),
)
GROUPS = {"3": (3,), "4": (4,), "5": (5,), "5 to 8": (5, 6, 7, 8)}

app = typer.Typer(add_completion=False, rich_markup_mode=None)


def solve(cell: Cell, runs: int, seed: int) -> Counter[tuple[Setting, str]]:
    """Outcomes of all settings on the readings of one cell."""
    noise, patient, count, outliers = cell
    key = [seed, list(NoiseReading).index(noise), patient, count, outliers]
    seen = draw_readings(sites_mm(patient), count, outliers, noise, runs, np.random.default_rng(key))
    variance_mm2 = sum(per_axis_mm(one, noise) ** 2 for one in (IMAGE_SIGMA_MM, PHYSICAL_SIGMA_MM))
    outcomes: Counter[tuple[Setting, str]] = Counter()
    for run, pairs in enumerate(seen.pairs.tolist()):
        right = frozenset((i, j) for i, j in pairs)
        for setting in SETTINGS:
            evidence = Evidence(variance_mm2, *setting)
            found = PairingSearch(seen.image_mm[run], seen.physical_mm[run], evidence, None, None).answer()
            outcomes[setting, verdict(found.status, found.pairs, right)] += 1
    return outcomes


@app.command()
def main(
    runs: Annotated[int, typer.Option(min=1, help="Per patient and cell of the protocol.")] = 1000,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes [one per core].")] = None,
) -> None:
    """Unsuccessful and false shares against the odds."""
    cells = list(product(NoiseReading, PATIENTS, range(3, 9), OUTLIERS))
    with ProcessPoolExecutor(workers) as pool:
        found = dict(
            zip(cells, pool.map(solve, cells, [runs] * len(cells), [seed] * len(cells)), strict=True)
        )
    lines = ["| noise | odds of a pair | of a wide set | " + " | ".join(GROUPS) + " |", "|" + "---|" * 7]
    for noise, setting in product(NoiseReading, SETTINGS):
        shares = []
        for counts in GROUPS.values():
            group = [found[cell] for cell in cells if cell[0] is noise and cell[2] in counts]
            lost, false = (sum(one[setting, what] for one in group) for what in (UNSUCCESSFUL, FALSE))
            percent = 100.0 / (runs * len(group))
            shares.append(f"{lost * percent:.4f} / {false * percent:.4f}")
        lines.append(f"| {noise.value} | {setting[0]:g} | {setting[1]:g} | {' | '.join(shares)} |")
    typer.echo("\n".join(lines))


if __name__ == "__main__":
    app()
