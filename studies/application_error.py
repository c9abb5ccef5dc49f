"""Application error by depth (RONNA G3, Svaco et al. 2017), at superficial and deep phantom targets.

The paper's protocol is known from its summary only. Here: the phantom of the strategies study with targets
anywhere in the head, the thesis' OCS beside ours, set S of the arm's errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from studies.accuracy.phantom import Markers, draw_phantom
from studies.accuracy.scene import Scene
from studies.campaign import bounds
from studies.campaign.plots import boxes
from studies.campaign.study import Cell, Sums, Table, Unit, blocks

Array = NDArray[np.float64]
Series = tuple[str, str, str, int]  # depth, markers, strategy, number of spheres

STRATEGIES = ("thesis-ocs", "ocs")
PLACES = (5, 20, 21, 31, 40, 45, 46, 49)  # the first eight from which the arm reaches everything
TARGETS = 10
WHOLE_HEAD = 1.0
DEPTHS_MM: Mapping[str, tuple[float, float]] = {"0-50 mm": (0.0, 50.0), "50-120 mm": (50.0, 120.0)}
# Strojniski vestnik 63(2017)12, 725-735: mean and quartiles, mm.
PUBLISHED_MM = {"0-50 mm": (0.43, 0.22, 0.60), "50-120 mm": (0.88, 0.66, 1.10)}
COMPARED = (Markers.FRAME, "thesis-ocs", 4)  # the paper's conditions
BLOCK_ARMS = 125
QUARTILES = (25.0, 75.0)


@dataclass(frozen=True)
class ApplicationErrorStudy:
    """Application error study with `arms` random arms, each at all positions."""

    arms: int = 200
    seed: int = 0
    name: str = "application-error"

    def settings(self) -> dict[str, object]:
        return {**asdict(self), "places": list(PLACES), "targets": TARGETS}

    def units(self) -> Sequence[Unit]:
        """List the units for every depth, marker type and position."""
        conditions = [
            f"{depth}|{kind}|{place}" for depth in DEPTHS_MM for kind in Markers for place in PLACES
        ]
        return [unit for condition in conditions for unit in blocks(condition, self.arms, BLOCK_ARMS)]

    def run(self, unit: Unit) -> Sums:
        """Return all error lengths in mm, keyed `strategy|spheres|arm|target`."""
        depth, kind, number = unit.condition.split("|")
        markers = Markers(kind)
        drawn = draw_phantom(markers, DEPTHS_MM[depth], TARGETS, WHOLE_HEAD)
        first = unit.block * BLOCK_ARMS
        scene = Scene.of(self.seed, drawn, markers, int(number))
        return scene.trials(range(first, first + unit.runs), STRATEGIES)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate our figures next to those of the paper."""
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
            "Application error by depth",
            rows,
            "Depth of the target below the skin, along the trajectory. Published: RONNA G3 on a "
            "phantom, one arm. Compared with the closest case here: the x-shaped frame, the thesis' "
            f"OCS. {bounds.CAPTION}: of the mean, from the scatter of the arms (Student).",
        )
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot a box for each depth, marker type and strategy."""
    groups = {
        f"{strategy} {markers} {count}, {depth}": errors.ravel()
        for (depth, markers, strategy, count), errors in _collect_errors(sums).items()
    }
    return {"application-error.png": boxes("Error at the target by depth", "mm", groups)}


def _collect_errors(sums: Mapping[str, Sums]) -> dict[Series, Array]:
    """Collect the errors of each series, (arms, n) in mm."""
    found: dict[Series, dict[int, list[float]]] = {}
    for condition, content in sums.items():
        depth, markers, _ = condition.split("|")
        for key, error_mm in content.items():
            strategy, count, arm, _ = key.split("|")
            of_series = found.setdefault((depth, markers, strategy, int(count)), {})
            of_series.setdefault(int(arm), []).append(error_mm)
    return {series: np.array(list(found[series].values())) for series in sorted(found, key=_order_key)}


def _order_key(series: Series) -> tuple[int, int, int, int]:
    depth, markers, strategy, count = series
    # the frame first, as used in the paper
    return list(DEPTHS_MM).index(depth), markers == Markers.FREE, STRATEGIES.index(strategy), count
