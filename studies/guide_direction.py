"""Error by depth with a guide that is held outside the head: the effect missing from a tool at the target.

A guide turns errors of direction into errors of the tip, in proportion to its distance from the target. Set S
places the tool wrongly but leaves its direction alone. Here the bore also deviates by an angle that belongs
to the arm's tool and is the same in every pose. Its size is a FIT and not a measurement: it is chosen so that
the two mean errors of RONNA G3 come out, with both kinds of markers pooled. That these two agree afterwards
confirms nothing. Quartiles, and each kind of marker alone, are not used in the fit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ronna_hw.arrays import Array
from studies.accuracy.phantom import Markers, draw_phantom
from studies.accuracy.random_arms import RandomArms, Source
from studies.accuracy.scene import Sizes, StudiedScene
from studies.campaign.study import Cell, Sums, Table
from studies.ronna_g3 import (
    DEEP,
    DEPTHS_MM,
    PUBLISHED_MM,
    PUBLISHED_RATIO,
    SUPERFICIAL,
    TARGETS,
    WHOLE_HEAD,
    rest_outside,
)

STRATEGY = "thesis-ocs"
# From the entry to the end of the guide. The paper's is not known; ours hold it 30 mm before the entry.
RESTS_MM: Mapping[str, float] = {"guide at the entry": 0.0, "guide 30 mm before it": 30.0}
FITTED_REST = "guide at the entry"
SIZES_MRAD = tuple(range(11))  # of the bore's direction, one standard deviation per axis
EVERY = "all effects"
REGISTRATION, ARM, GUIDE = "CT of the spheres", "arm", "guide direction, 1 mrad"
EFFECTS = (REGISTRATION, ARM, GUIDE)
BIN_MM = 0.01
QUARTILES = (0.25, 0.75)
POOLED = "pooled"
Key = tuple[str, str, str, str]  # rest, effect or size, depth, markers


def run_guided(seed: int, condition: Sequence[str], arms: Sequence[int]) -> Sums:
    """Return numbers of errors per bin, keyed `effect|bin`, and their sums in mm, `effect|mm`.

    `condition`: rest, depth, markers and position. Effects: the size in mrad, or one of EFFECTS alone.
    """
    rest, depth, kind, place = condition
    markers = Markers(kind)
    drawn = draw_phantom(markers, DEPTHS_MM[depth], TARGETS, WHOLE_HEAD)
    scene = rest_outside(StudiedScene.of(seed, drawn, markers, int(place)), RESTS_MM[rest])
    robots, chance, planned = RandomArms.draw(seed, arms), scene.chance(arms), scene.planned(STRATEGY)
    straight = scene.errors_mm(robots, planned, chance, Sizes())
    # the tip is an affine function of the bore's direction
    per_mrad = scene.errors_mm(robots, planned, chance, Sizes(guide_rad=1e-3)) - straight
    only_ct = scene.errors_mm(robots.only(Source.CT), planned, chance, Sizes().only(Source.CT))
    errors = {str(size): straight + size * per_mrad for size in SIZES_MRAD} | {
        REGISTRATION: only_ct,
        ARM: scene.errors_mm(robots, planned, chance, Sizes(ct_mm=0.0)),
        GUIDE: per_mrad,
    }
    found: Sums = defaultdict(float)
    for effect, each in errors.items():
        lengths = np.linalg.norm(each, axis=-1).ravel()
        found[f"{effect}|mm"] = round(float(lengths.sum()), 6)
        for number in (lengths / BIN_MM).astype(int).tolist():
            found[f"{effect}|{number}"] += 1.0
    return dict(found)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the effects alone, the fit of the guide's direction, and what it says of the rest."""
    spread = _collect(sums)
    fitted = fit_size_mrad(spread, FITTED_REST)
    rows: list[dict[str, Cell]] = [
        {"guide": rest, "effect": effect, "markers": markers, **_means(spread, rest, effect, markers)}
        for rest in RESTS_MM
        for effect in EFFECTS
        for markers in Markers
    ]
    sizes: list[dict[str, Cell]] = [
        {
            "guide": rest,
            "mrad per axis": size,
            **_means(spread, rest, str(size), POOLED),
            "misfit %": 100.0 * _misfit(spread, rest, size),
            "": "fitted" if size == fit_size_mrad(spread, rest) else "",
        }
        for rest in RESTS_MM
        for size in SIZES_MRAD
    ]
    return [
        Table.of(
            "Which effect grows with depth",
            rows,
            f"Each effect alone, {STRATEGY}, all spheres. Arm: everything of set S but the CT. Published "
            f"ratio of deep to superficial: {PUBLISHED_RATIO:.2f}. A random tilt of the needle in the bore "
            "has the lever of the guide's direction, and so the same ratio.",
        ),
        Table.of(
            "Guide direction, fitted",
            sizes,
            "All effects, both kinds of markers pooled. Misfit: rms of the relative deviations from the two "
            "published means. Fitted: the size with the least misfit.",
        ),
        Table.of(
            "With the fitted guide direction",
            [_row_beside(spread, str(fitted), markers) for markers in (POOLED, *Markers)],
            f"{FITTED_REST.capitalize()}, {fitted} mrad per axis, fitted to the two published means. Not "
            "fitted: the quartiles, and each kind of marker alone. The paper pools both kinds.",
        ),
    ]


def fit_size_mrad(spread: Mapping[Key, Array], rest: str) -> int:
    """Return the direction error in mrad with the least misfit to the published pooled means."""
    return min(SIZES_MRAD, key=lambda size: _misfit(spread, rest, size))


def _misfit(spread: Mapping[Key, Array], rest: str, size: int) -> float:
    apart = [
        _mean(_pool(spread, rest, str(size), depth, POOLED)) / PUBLISHED_MM[depth][0] - 1.0
        for depth in DEPTHS_MM
    ]
    return float(np.sqrt(np.mean(np.square(apart))))


def _collect(sums: Mapping[str, Sums]) -> dict[Key, Array]:
    """Collect each series as an array: the sum in mm, then the number of errors in each bin."""
    totals: dict[Key, dict[int, float]] = defaultdict(lambda: defaultdict(float))
    for key, bin_number, value in _entries(sums):
        totals[key][bin_number] += value
    length = 1 + max((max(one) for one in totals.values()), default=0)
    return {
        key: np.array([one.get(number, 0.0) for number in range(-1, length)]) for key, one in totals.items()
    }


def _entries(sums: Mapping[str, Sums]) -> Iterator[tuple[Key, int, float]]:
    for condition, content in sums.items():
        rest, depth, markers, _ = condition.split("|")
        if rest in RESTS_MM:
            for name, value in content.items():
                effect, what = name.split("|")
                yield (rest, effect, depth, markers), -1 if what == "mm" else int(what), value


def _pool(spread: Mapping[Key, Array], rest: str, effect: str, depth: str, markers: str) -> Array:
    kinds = tuple(Markers) if markers == POOLED else (markers,)
    return np.asarray(np.sum([spread[rest, effect, depth, kind] for kind in kinds], axis=0))


def _mean(series: Array) -> float:
    return float(series[0] / series[1:].sum())


def _quartiles(series: Array) -> str:
    upto = np.cumsum(series[1:]) / series[1:].sum()
    return "-".join(f"{BIN_MM * (np.searchsorted(upto, share) + 0.5):.2f}" for share in QUARTILES)


def _means(spread: Mapping[Key, Array], rest: str, effect: str, markers: str) -> dict[str, Cell]:
    superficial, deep = (_mean(_pool(spread, rest, effect, depth, markers)) for depth in DEPTHS_MM)
    return {f"{SUPERFICIAL}, mean": superficial, f"{DEEP}, mean": deep, "ratio": deep / superficial}


def _row_beside(spread: Mapping[Key, Array], effect: str, markers: str) -> dict[str, Cell]:
    means = _means(spread, FITTED_REST, effect, markers)
    row: dict[str, Cell] = {"markers": markers}
    for depth in DEPTHS_MM:
        mean, low, high = PUBLISHED_MM[depth]
        row |= {
            f"{depth}, published": f"{mean:.2f} ({low:.2f}-{high:.2f})",
            f"{depth}, mean": means[f"{depth}, mean"],
            f"{depth}, quartiles": _quartiles(_pool(spread, FITTED_REST, effect, depth, markers)),
        }
    ratio = float(str(means["ratio"]))
    return row | {"ratio": ratio, "differs by %": 100.0 * (ratio / PUBLISHED_RATIO - 1.0)}
