"""Application error by depth (RONNA G3, Svaco et al. 2017), at superficial and deep phantom targets.

Here: the phantom of the strategies study with targets anywhere in the head, the thesis' OCS beside ours, set
S of the arm's errors. First as the paper's summary has it (`studies.ronna_g3`), by position and depth, then
with the tool itself at the target, and last the fit of the guide's direction (`studies.guide_direction`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from ronna_hw.arrays import Array
from studies.accuracy.phantom import Markers, draw_phantom
from studies.accuracy.scene import StudiedScene
from studies.campaign import bounds
from studies.campaign.plots import boxes
from studies.campaign.study import Cell, Study, Sums, Table, Unit, blocks_of_each
from studies.guide_direction import RESTS_MM, run_guided
from studies.guide_direction import tables as guide_tables
from studies.ronna_g3 import (
    ALTERNATIVES,
    DEPTHS_MM,
    OF_ALL_ARMS,
    PUBLISHED_MM,
    TARGETS,
    WHOLE_HEAD,
    run_protocol,
)
from studies.ronna_g3 import tables as protocol_tables
from studies.thesis_tables import NEUROMATE_IN_VITRO_MM

Series = tuple[str, str, str, int]  # depth, markers, strategy, number of spheres

STRATEGIES = ("thesis-ocs", "ocs")
PLACES = (5, 20, 21, 31, 40, 45, 46, 49)  # the first eight from which the arm reaches everything
COMPARED = (Markers.FRAME, "thesis-ocs", 4)  # the thesis' own frame
TIP_AT_TARGET = "tip at the target"
MOST_ARMS_OF_GUIDES = 40  # enough for a mean
BLOCK_ARMS = 125
QUARTILES = (25.0, 75.0)


@dataclass(frozen=True)
class ApplicationErrorStudy(Study):
    """Application error study with `arms` random arms, each at all positions."""

    arms: int = 200
    seed: int = 0
    name: str = "application-error"

    constants: ClassVar = {"places": list(PLACES), "targets": TARGETS}

    def units(self) -> Sequence[Unit]:
        few = min(self.arms, MOST_ARMS_OF_GUIDES)
        return [
            *blocks_of_each(product((TIP_AT_TARGET,), DEPTHS_MM, Markers, PLACES), self.arms, BLOCK_ARMS),
            *blocks_of_each(product(RESTS_MM, DEPTHS_MM, Markers, PLACES), few, BLOCK_ARMS),
            *blocks_of_each(product(OF_ALL_ARMS, DEPTHS_MM, Markers, PLACES), self.arms, BLOCK_ARMS),
            *blocks_of_each(
                product([one for one in ALTERNATIVES if one not in OF_ALL_ARMS], DEPTHS_MM, Markers, PLACES),
                few,
                BLOCK_ARMS,
            ),
        ]

    def run(self, unit: Unit) -> Sums:
        """Return all error lengths in mm, keyed `strategy|spheres|arm|target` or as by the first field.

        See `run_protocol` and, with a guide, `run_guided`.
        """
        rest, depth, kind, number = unit.condition.split("|")
        first = unit.block * BLOCK_ARMS
        arms = range(first, first + unit.runs)
        if rest in ALTERNATIVES:
            return run_protocol(self.seed, (rest, depth, kind, number), arms)
        if rest != TIP_AT_TARGET:
            return run_guided(self.seed, (rest, depth, kind, number), arms)
        markers = Markers(kind)
        drawn = draw_phantom(markers, DEPTHS_MM[depth], TARGETS, WHOLE_HEAD)
        return StudiedScene.of(self.seed, drawn, markers, int(number)).trials(arms, STRATEGIES)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    rows: list[dict[str, Cell]] = []
    for (depth, markers, strategy, count), errors in _collect_errors(sums).items():
        published = PUBLISHED_MM[depth] if (markers, strategy, count) == COMPARED else None
        mean = float(errors.mean())
        rows.append(
            {
                "depth": depth,
                "markers": markers,
                "strategy": strategy,
                "spheres": count,
                "published mean mm": None if published is None else published[0],
                "mean mm": mean,
                bounds.column("mean"): bounds.mean_length(errors.mean(axis=1)).text,
                "differs by %": None if published is None else 100.0 * (mean / published[0] - 1.0),
                "published quartiles": None
                if published is None
                else f"{published[1]:.2f}-{published[2]:.2f}",
                "quartiles": "-".join(f"{value:.2f}" for value in np.percentile(errors, QUARTILES)),
            }
        )
    return [
        Table.of(
            "Other systems",
            [
                {"system": system, "mean mm": mean_mm, "sd mm": sd_mm}
                for system, (mean_mm, sd_mm) in NEUROMATE_IN_VITRO_MM.items()
            ],
            "In vitro, as section 3.2 of the thesis cites them; which others it names is not known here.",
        ),
        *protocol_tables(sums),
        Table.of(
            "Application error by depth",
            rows,
            "The tool itself is at the target. Depth of the target below the skin, along the trajectory. "
            "Published: RONNA G3 on a phantom, one arm. Compared with the closest case here: the x-shaped "
            f"frame, the thesis' OCS. {bounds.CAPTION}: of the mean, from the scatter of the arms (Student).",
        ),
        *guide_tables(sums),
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    groups = {
        f"{strategy} {markers} {count}, {depth}": errors.ravel()
        for (depth, markers, strategy, count), errors in _collect_errors(sums).items()
    }
    return {"application-error.png": boxes("Error at the target by depth", "mm", groups)}


def _collect_errors(sums: Mapping[str, Sums]) -> dict[Series, Array]:
    """Collect the errors of each series, (arms, n) in mm."""
    found: dict[Series, dict[int, list[float]]] = {}
    for condition, content in sums.items():
        rest, depth, markers, _ = condition.split("|")
        if rest != TIP_AT_TARGET:
            continue
        for key, error_mm in content.items():
            strategy, count, arm, _ = key.split("|")
            of_series = found.setdefault((depth, markers, strategy, int(count)), {})
            of_series.setdefault(int(arm), []).append(error_mm)
    return {series: np.array(list(found[series].values())) for series in sorted(found, key=_order_key)}


def _order_key(series: Series) -> tuple[int, int, int, int]:
    depth, markers, strategy, count = series
    # the frame first, as used in the paper
    return list(DEPTHS_MM).index(depth), markers == Markers.FREE, STRATEGIES.index(strategy), count
