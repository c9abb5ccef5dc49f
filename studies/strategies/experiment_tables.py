"""Tables of the experiment fitted to table 4: means, spread, the fall of NOS, and what the fit moved."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from scipy.stats import chi2

from ronna_hw.arrays import Array
from sim.world.scene.as_built import TOOL_ERROR_MM
from studies.accuracy.scene import CT_FLE_MM
from studies.campaign.study import Cell, Sums, Table
from studies.strategies.one_experiment import (
    CELLS,
    CT,
    DRAWN,
    FALLS,
    GIVEN,
    LEFT_OUT,
    MOVABLE,
    MOVED,
    NUMBERS,
    ROWS,
    SIZE,
    TOOL,
    key_of,
)
from studies.thesis_tables import TABLE_4

LOW_SHARE, HIGH_SHARE = 5.0, 95.0  # per cent of the arms
LIKELY = 0.95
ALIKE = 1.5  # factor between two spreads


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Compare the arms as drawn, given table 4, and the cells left out, with table 4."""
    arms: dict[str, list[float]] = defaultdict(list)
    for content in sums.values():
        for key, value in content.items():
            arms[key.rpartition("|")[0]].append(value)
    series = {key: np.array(values) for key, values in arms.items()}
    return [
        _tabulate_means(series),
        _tabulate_spread(series),
        _tabulate_fall(series),
        _tabulate_numbers(series),
    ]


def _range(values: Array) -> str:
    low, high = np.percentile(values, [LOW_SHARE, HIGH_SHARE])
    return f"{low:.2f}-{high:.2f}"


def _tabulate_means(series: Mapping[str, Array]) -> Table:
    rows: list[dict[str, Cell]] = []
    for cell, thesis in CELLS.items():
        drawn, given = (series[f"{name}|{key_of(cell)}|mean"] for name in (DRAWN, GIVEN))
        left_out = series[f"{LEFT_OUT}|{key_of(cell)}"]
        rows.append(
            {
                "strategy": cell[0],
                "spheres": cell[1],
                "thesis mean mm": thesis.mean_mm,
                "as drawn": float(drawn.mean()),
                "5-95 % of the arms": _range(drawn),
                "fitted": float(given.mean()),
                "fitted differs by %": 100.0 * float(given.mean() / thesis.mean_mm - 1.0),
                "if left out of the fit": float(left_out.mean()),
                "differs by %": 100.0 * float(left_out.mean() / thesis.mean_mm - 1.0),
                "5-95 % of the arms left out": _range(left_out),
            }
        )
    return Table.of(
        "Means, fitted to table 4",
        rows,
        "Each arm's mean over 8 positions and 10 targets, then the mean over the arms. As drawn: tool frame "
        "and CT of set S. Fitted: tool frame and CT of each arm moved as little as possible until it shows "
        "the eight means. Left out: predicted by an arm fitted to the other seven.",
    )


def _tabulate_spread(series: Mapping[str, Array]) -> Table:
    rows: list[dict[str, Cell]] = []
    for cell, thesis in CELLS.items():
        printed = {
            "sd": thesis.sd_mm,
            "max": thesis.largest_mm,
            "min": thesis.least_mm,
            "between trajectories": float(np.var(thesis.trajectories_mm, ddof=1)) / thesis.sd_mm**2,
        }
        row: dict[str, Cell] = {"strategy": cell[0], "spheres": cell[1]}
        for name, value in printed.items():
            each = series[f"{GIVEN}|{key_of(cell)}|{name}"]
            row |= {f"thesis {name}": value, name: float(each.mean()), f"{name}, 5-95 %": _range(each)}
        factors = series[f"{GIVEN}|{key_of(cell)}|sd"] / thesis.sd_mm
        alike = np.maximum(factors, 1.0 / factors) <= ALIKE
        rows.append(
            row
            | {
                "sd by that of the thesis": float(factors.mean()),
                f"arms within a factor of {ALIKE} %": 100.0 * float(alike.mean()),
            }
        )
    return Table.of(
        "Spread within one arm",
        rows,
        "Statistics of each fitted arm over its 80 trials, as table 4 has them of its one arm; then their "
        "mean and range over the arms. No figure here is in the fit of an arm; tilts and positions were "
        "chosen for the sd of NOS.",
    )


def _tabulate_fall(series: Mapping[str, Array]) -> Table:
    few, many = (TABLE_4["NOS", count] for count in (3, 5))
    of_nos = np.subtract(few.trajectories_mm, many.trajectories_mm)
    of_ocs = np.subtract(TABLE_4["OCS", 3].trajectories_mm, TABLE_4["OCS", 5].trajectories_mm)
    thesis_mm = few.mean_mm - many.mean_mm
    rows: list[dict[str, Cell]] = [
        {
            "arms": "thesis",
            "rms misfit of the means %": None,
            "NOS falls by mm": thesis_mm,
            "its sd over the arms": None,
            "arms with that fall or more %": None,
            "rows of 3 and 5 correlate": float(np.corrcoef(few.trajectories_mm, many.trajectories_mm)[0, 1]),
            "falls of NOS and OCS correlate": float(np.corrcoef(of_nos, of_ocs)[0, 1]),
        }
    ]
    for name in (DRAWN, GIVEN, *MOVABLE):
        falls = series[f"{name}|nos|3|mean"] - series[f"{name}|nos|5|mean"]
        misfits = [series[f"{name}|{key_of(cell)}|mean"] / row.mean_mm - 1.0 for cell, row in CELLS.items()]
        rows.append(
            {
                "arms": {DRAWN: "as drawn", GIVEN: "fitted"}.get(name, f"fitted by the {name}"),
                "rms misfit of the means %": 100.0 * float(np.sqrt(np.mean(np.square(misfits)))),
                "NOS falls by mm": float(falls.mean()),
                "its sd over the arms": float(falls.std(ddof=1)),
                "arms with that fall or more %": 100.0 * float(np.mean(falls >= thesis_mm)),
                **{
                    column: float(np.median(series[f"{name}|{what}"])) if name in (DRAWN, GIVEN) else None
                    for what, column in (
                        (ROWS, "rows of 3 and 5 correlate"),
                        (FALLS, "falls of NOS and OCS correlate"),
                    )
                },
            }
        )
    return Table.of(
        "The fall of NOS from three to five spheres",
        rows,
        "In table 4 all ten trajectories fall, and the rows keep their shape and their spread, so the "
        "cause is alike in all places and trajectories. Correlations are medians over the arms.",
    )


def _tabulate_numbers(series: Mapping[str, Array]) -> Table:
    rows: list[dict[str, Cell]] = [
        {
            "": label,
            "set S": expected,
            "median": float(np.median(series[f"{key}|"])),
            "5-95 %": _range(series[f"{key}|"]),
        }
        for label, key, expected in (
            ("tool frame, mm per axis", TOOL, TOOL_ERROR_MM),
            ("CT, 3-D rms mm", CT, CT_FLE_MM),
            (f"sum of squares of the {NUMBERS}, in standard deviations", SIZE, float(NUMBERS)),
            ("sum of squares of their shifts", MOVED, 0.0),
        )
    ]
    limit = float(chi2.ppf(LIKELY, NUMBERS))
    share = 100.0 * float(np.mean(series[f"{SIZE}|"] <= limit))
    return Table.of(
        "What the fit has moved",
        rows,
        f"{share:.0f} % of the fitted arms have a sum below {limit:.1f}, as {100 * LIKELY:.0f} % of set S "
        "do. The nearer the two shares, the more ordinary a draw is table 4.",
    )
