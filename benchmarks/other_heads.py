"""Pairing by the thesis' matrix on other heads than those of the studies, as the thesis' are not published.

    python -m benchmarks.other_heads > other-heads.json

Twenty sets of three heads of the same distribution; on each the thesis' protocol with three and four
markers, e = 1.5 mm, validated, noise as the length of the error. Per set, the least and the largest share
of unsuccessful pairings over 0 to 4 outliers, and the largest of false ones.
"""

from __future__ import annotations

import json

import numpy as np

from procedures.registration.similarity_matrix import match_many_by_similarity
from procedures.registration.thesis_matching import validate_many
from studies.correspondence.outcomes import FALSE, UNSUCCESSFUL, outcome_of, pair_set
from studies.correspondence.study import OUTLIERS
from studies.heads import PATIENTS, NoiseReading, draw_readings, sites_mm, variance_from_thesis_mm2

SETS = range(1, 21)  # seeds of the sites
RUNS, SEED = 500, 47  # per head and number of outliers
MARKERS = (3, 4)
E_MM = 1.5
NOISE = NoiseReading.NORM


def shares_percent(sites_seed: int, markers: int) -> tuple[list[float], list[float]]:
    """Return the shares of unsuccessful and of false pairings on one set of heads, by outliers."""
    unsuccessful, false = [], []
    for outliers in OUTLIERS:
        outcomes: list[str] = []
        for patient in PATIENTS:
            random = np.random.default_rng([SEED, sites_seed, patient, markers, outliers])
            seen = draw_readings(sites_mm(patient, sites_seed), markers, outliers, NOISE, RUNS, random)
            found = match_many_by_similarity(seen.image_mm, seen.physical_mm, np.full(RUNS, E_MM), markers)
            valid = validate_many(seen.image_mm, seen.physical_mm, found, variance_from_thesis_mm2(NOISE))
            outcomes += [
                outcome_of(one, pair_set(right)) for one, right in zip(valid, seen.pairs, strict=True)
            ]
        unsuccessful.append(100.0 * sum(one in UNSUCCESSFUL for one in outcomes) / len(outcomes))
        false.append(100.0 * outcomes.count(FALSE) / len(outcomes))
    return unsuccessful, false


def main() -> None:
    """Print the shares of every set, and their extremes, as JSON."""
    result: dict[str, object] = {"e_mm": E_MM, "runs_a_cell": RUNS * len(PATIENTS), "seed": SEED}
    for markers in MARKERS:
        shares = [shares_percent(one, markers) for one in SETS]
        least, largest = ([extreme(one) for one, _ in shares] for extreme in (min, max))
        result[f"markers_{markers}"] = {
            "sets": [{"unsuccessful": one, "false": false} for one, false in shares],
            "least_percent": {"from": min(least), "to": max(least)},
            "largest_percent": {"from": min(largest), "to": max(largest)},
            "largest_false_percent": max(max(false) for _, false in shares),
        }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
