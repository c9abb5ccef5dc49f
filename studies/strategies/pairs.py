"""Two strategies on the same arms: is one closer to the target, and could that be chance?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from studies.campaign import bounds
from studies.campaign.table import Cell, Table
from studies.campaign.unit import Sums
from studies.strategies.study import OF_ARM, PLACES, SCENARIO, TARGETS

PAIRS = (("improved", "ocs"), ("improved", "jdms"), ("best", "ocs"), ("best", "improved"))
SCENARIOS = ("set S", "tool and kinematics calibrated, fine CT")


def pairs(sums: Mapping[str, Sums]) -> Table:
    """Differences between the arms' means, the 95 % confidence interval of their mean, and a paired test."""
    totals: dict[tuple[str, str, int], dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for condition, content in sums.items():
        if condition.split("|")[0] != SCENARIO:
            continue
        for key, sum_mm in content.items():
            scenario, strategy, spheres, what = key.split("|")
            if scenario in SCENARIOS and what.startswith(OF_ARM):
                totals[scenario, strategy, int(spheres)][what] += sum_mm / (PLACES * TARGETS)
    rows: list[list[Cell]] = []
    for scenario in SCENARIOS:
        for count in sorted({one[2] for one in totals if one[0] == scenario}):
            for one, other in PAIRS:
                mine, others = totals[scenario, one, count], totals[scenario, other, count]
                apart = np.array([mine[arm] - others[arm] for arm in sorted(mine)])
                rows.append([scenario, f"{one} - {other}", count, *_judged(apart)])
    return Table(
        "Two strategies on the same arms",
        ("scenario", "pair", "spheres", "difference mm", "95 % from", "to", "arms where it is less %", "p"),
        rows,
        "Free spheres, the mean of each arm over 8 positions and 10 targets. p: Wilcoxon signed-rank "
        "test, two-sided. Best chooses by the predicted error; if it chooses the same everywhere, "
        "nothing differs.",
    )


def _judged(apart_mm: NDArray[np.float64]) -> list[Cell]:
    count, mean = len(apart_mm), float(apart_mm.mean())
    if count < 2 or not apart_mm.any():
        return [mean, mean, mean, 0.0, None]
    bound = bounds.mean(apart_mm)
    p = f"{float(wilcoxon(apart_mm).pvalue):.1e}"
    return [mean, bound.low, bound.high, 100.0 * float(np.mean(apart_mm < 0.0)), p]
