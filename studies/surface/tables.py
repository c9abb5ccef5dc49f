"""Tables and pictures of the study of surface registrations, with published figures beside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from procedures.reporting.pictures import ROSA_ON_SKIN_MM
from studies.campaign import bounds
from studies.campaign.plots import boxes, scatters
from studies.campaign.study import (
    GOALS,
    Cell,
    Sums,
    Table,
    judge_at_least,
    judge_at_most,
    judge_within,
)
from studies.surface.conditions import (
    DEPTHS_MM,
    DEVELOPMENT,
    JUDGED,
    NOISES_MM,
    OFFSETS_MM,
    REFUSABLE,
    SHIFTED,
    SHOWN_BESIDE,
    Coverage,
    Skin,
)
from studies.surface.kinds import Kinds
from studies.surface.outcomes import (
    Outcome,
    accepted,
    correlation_squared,
    read_outcomes,
    refused_share,
    share_within,
    targets_of,
)
from studies.surface.study import CHANGED, DRAWN

SIZE_EDGES_MM = (0.1, 0.2, 0.4, 0.8)
LENGTH_EDGES_MM = (12.0, 20.0, 32.0, 50.0)
HIGH_PERCENTILE = 95.0

# Goals, stated before the study was run
WITHIN_PERCENT, LEAST_CORRELATION, LEAST_NOTICED = (93.0, 97.0), 0.5, 95.0
RIGID_MEAN_MM, RIGID_UNPREDICTED_MM = 0.37, 0.9

PUBLISHED: tuple[dict[str, Cell], ...] = (
    {"": "ROSA, surface (Lefranc 2014, clinical)", "mean mm": ROSA_ON_SKIN_MM, "R²": None},
    {"": "ROSA, fiducials (the same)", "mean mm": 0.70, "R²": None},
    {"": "ROSA, frame (the same)", "mean mm": 0.81, "R²": None},
    {"": "surface, at the target (Mongen and Willems 2019, clinical)", "mean mm": 5.35, "R²": 0.04},
    {"": "markers (the same)", "mean mm": 2.49, "R²": None},
)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Return the goals, the errors by each variable, refusals, shifted skin, and the published figures.

    All but one are of the judged skins. A study without these has tables of its development skins instead.
    """
    outcomes = read_outcomes(sums)
    name, chosen = _choose(outcomes)
    shifted = [one for one in outcomes if one.skin == SHIFTED]
    return [
        Table("Goals", GOALS, _goals(chosen, outcomes, shifted), _count(name, chosen)),
        Table.of(
            "By coverage",
            [_row("coverage", coverage, _of(chosen, coverage)) for coverage in Coverage],
            f"{name.capitalize()} skins only. R²: true errors by the predicted rms; that of errors drawn "
            "from the predictions is what there would be if all of these were right. "
            f"{bounds.NOTE} The targets of a head count as one group.",
        ),
        Table.of(
            "By coverage and skin",
            [
                {"coverage": coverage, **_row("skin", skin, these)}
                for coverage in Coverage
                for skin in Skin
                if (these := [one for one in outcomes if (one.coverage, one.skin) == (coverage, skin)])
            ],
            f"Judged are {', '.join(JUDGED)}. The others were seen as the estimator was developed.",
        ),
        Table.of("By variable", _by_variable(chosen), f"{name.capitalize()} skins, all coverages."),
        Table.of("Refusals", _refusals(chosen), "Numbers of registrations by the code of their refusal."),
        Table.of("Skin shifted by 1 mm over a third of the scan", _shifted(shifted)),
        Table.of(
            "Beside published figures",
            [
                *PUBLISHED,
                *(
                    {
                        "": f"here: {coverage}, registration alone",
                        "mean mm": _mean(_of(chosen, coverage)),
                        "R²": correlation_squared(_of(chosen, coverage)),
                    }
                    for coverage in Coverage
                ),
            ],
            "Published are errors of whole systems in patients; here are errors of the registration alone, "
            "with an exact arm and a CT that is exact but for its level. They cannot be ranked.",
        ),
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Draw errors by coverage, and true against predicted errors."""
    _, chosen = _choose(read_outcomes(sums))
    found = {coverage: targets_of(_of(chosen, coverage)) for coverage in Coverage}
    return {
        "surface-errors.png": boxes(
            "Registration on the skin: errors of accepted registrations",
            "error at the target, mm",
            {f"{coverage}": one[:, 0] for coverage, one in found.items() if len(one)},
        ),
        "surface-prediction.png": scatters(
            "Registration on the skin: true errors against their prediction",
            "predicted rms, mm",
            "error, mm",
            {f"{coverage}": (one[:, 1], one[:, 0]) for coverage, one in found.items() if len(one)},
        ),
    }


def _choose(outcomes: Sequence[Outcome]) -> tuple[Kinds, Sequence[Outcome]]:
    """Return the outcomes that the tables are about, and their kinds."""
    if judged := [one for one in outcomes if one.skin in JUDGED]:
        return Kinds.JUDGED, judged
    return Kinds.DEVELOPMENT, [one for one in outcomes if one.skin in DEVELOPMENT]


def _goals(
    chosen: Sequence[Outcome], outcomes: Sequence[Outcome], shifted: Sequence[Outcome]
) -> list[Sequence[Cell]]:
    rows = []
    within, explained = share_within(chosen), correlation_squared(chosen)
    if within is not None and explained is not None:
        rows.append(judge_within("targets within their 95 % limit, %", within.value, WITHIN_PERCENT))
        rows.append(judge_at_least("R² of true by predicted error", explained, LEAST_CORRELATION))
    for coverage in REFUSABLE:
        if (within := share_within(_of(chosen, coverage))) is not None:
            name = f"{coverage}: targets within their limit where not refused, %"
            rows.append(judge_at_least(name, within.value, WITHIN_PERCENT[0]))
    if shifted:
        noticed = 100.0 * sum(map(_is_noticed, shifted)) / len(shifted)
        rows.append(judge_at_least(f"{SHIFTED}: noticed, %", noticed, LEAST_NOTICED))
    rigid = targets_of([one for one in outcomes if one.skin == Skin.RIGID and one.coverage in SHOWN_BESIDE])
    if len(rigid):
        beyond = rigid[rigid[:, 0] > rigid[:, 2], 0]
        rows.append(judge_at_most("rigid phantom: mean error, mm", float(rigid[:, 0].mean()), RIGID_MEAN_MM))
        rows.append(
            judge_at_most(
                "rigid phantom: largest error beyond its limit, mm",
                float(beyond.max(initial=0.0)),
                RIGID_UNPREDICTED_MM,
            )
        )
    return rows


def _count(kinds: Kinds, chosen: Sequence[Outcome]) -> str:
    heads = len({one.head for one in chosen})
    return (
        f"{len(chosen)} {kinds} registrations on {heads} heads, of them {len(accepted(chosen))} accepted. "
        "The goals of the issue are for 10,000 judged ones."
    )


def _row(name: str, value: Cell, chosen: Sequence[Outcome]) -> dict[str, Cell]:
    targets = targets_of(chosen)
    within = share_within(chosen)
    return {
        name: value,
        "registrations": len(chosen),
        "refused %": refused_share(chosen).value if chosen else None,
        "mean mm": _mean(chosen),
        "95th percentile mm": float(np.percentile(targets[:, 0], HIGH_PERCENTILE)) if len(targets) else None,
        "largest mm": float(targets[:, 0].max()) if len(targets) else None,
        "mean limit mm": float(targets[:, 2].mean()) if len(targets) else None,
        "within limit %": None if within is None else within.value,
        bounds.column("within"): "" if within is None else within.text,
        "R²": correlation_squared(chosen),
        "R² of drawn errors": correlation_squared(chosen, DRAWN),
    }


def _by_variable(outcomes: Sequence[Outcome]) -> list[dict[str, Cell]]:
    rows: list[dict[str, Cell]] = []
    for variable, edges in (("size_mm", SIZE_EDGES_MM), ("length_mm", LENGTH_EDGES_MM)):
        for low, high in pairwise(edges):
            chosen = _where(outcomes, lambda one: low <= one.values[variable] <= high)  # noqa: B023  # called at once
            rows.append({"variable": variable, **_row("value", f"{low:g} to {high:g}", chosen)})
    for variable, values in (("offset_sd_mm", OFFSETS_MM), ("noise_mm", NOISES_MM)):
        for value in values:
            chosen = _where(outcomes, lambda one: one.values[variable] == value)  # noqa: B023  # called at once
            rows.append({"variable": variable, **_row("value", f"{value:g}", chosen)})
    for depth in DEPTHS_MM:
        chosen = [one.at_depth(depth) for one in outcomes]
        rows.append({"variable": "depth", **_row("value", depth, chosen)})
    return rows


def _refusals(outcomes: Sequence[Outcome]) -> list[dict[str, Cell]]:
    codes = sorted({one.refusal for one in outcomes if one.refusal})
    rows: list[dict[str, Cell]] = []
    for coverage in Coverage:
        chosen = _of(outcomes, coverage)
        counts = Counter(one.refusal for one in chosen)
        rows.append(
            {"coverage": coverage, "registrations": len(chosen), **{code: counts[code] for code in codes}}
        )
    return rows


def _shifted(shifted: Sequence[Outcome]) -> list[dict[str, Cell]]:
    counts = {
        "refused": sum(one.refusal is not None for one in shifted),
        "accepted, a changed region named": sum(
            one.refusal is None and one.values.get(CHANGED, 0.0) > 0.0 for one in shifted
        ),
        "accepted, every target within its limit": sum(
            one.refusal is None and bool(one.is_within.all()) for one in shifted
        ),
        "noticed: refused, or every target within its limit": sum(map(_is_noticed, shifted)),
    }
    return [{"outcome": name, "of": len(shifted), "number": count} for name, count in counts.items()]


def _is_noticed(outcome: Outcome) -> bool:
    """Whether a shift was noticed: refused, or every error is within what was predicted."""
    return outcome.refusal is not None or bool(outcome.is_within.all())


def _of(outcomes: Iterable[Outcome], coverage: Coverage) -> list[Outcome]:
    return [one for one in outcomes if one.coverage == coverage]


def _where(outcomes: Iterable[Outcome], is_chosen: Callable[[Outcome], bool]) -> list[Outcome]:
    return [one for one in outcomes if is_chosen(one)]


def _mean(outcomes: Sequence[Outcome]) -> float | None:
    targets = targets_of(outcomes)
    return float(targets[:, 0].mean()) if len(targets) else None
