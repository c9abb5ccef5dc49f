"""The goals of the localization next to the results of a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

from studies.campaign.table import Cell, Table
from studies.campaign.unit import Sums
from studies.localization.study import COVERED, JUDGING, STREAKED, TAIL, Method, pooled
from studies.localization.tables import of_method, percentile_um, tables

RMS_UM = {"good": (10.0, 35.0), "poor": (20.0, 50.0)}  # without and with streaks on posts
COVERED_RMS_UM = 40.0  # half buried
LARGEST_UM = 150.0
SHARE_95_UM = {"good": 50.0, "poor": 70.0}  # with streaks
CHI2 = (0.7, 1.4)
LEAST_OF_A_FAMILY = 60  # spheres: right covariances leave the range once in 900 times (20: once in 17)
CHANCE = 1e-3  # of right covariances to miss a goal for the tail
LEAST_SPHERES, LEAST_OBJECTS, LEAST_VOLUMES = 500, 500, 100
FLAGGED_PERCENT = 90.0  # of errors above 0.1 mm


def tables_and_goals(sums: Mapping[str, Sums]) -> list[Table]:
    """All tables of the study; the goals come last, if evaluation families were scanned."""
    held = goals(sums)
    return [*tables(sums), held] if held is not None else tables(sums)


def goals(sums: Mapping[str, Sums]) -> Table | None:
    """Ours against the goals, on families not used for tuning; None without them."""
    conditions = [condition for condition in sums if condition.split("|")[0] in JUDGING]
    if not conditions:
        return None
    rows: list[Sequence[Cell]] = []
    for protocol in dict.fromkeys(condition.split("|")[1] for condition in conditions):
        for streaked in (False, True):
            chosen = [
                condition
                for condition in conditions
                if condition.endswith(f"|{protocol}") and (condition.split("|")[0] in STREAKED) == streaked
            ]
            total = pooled(sums, chosen)
            found = of_method(total, Method.OURS, "found")
            if found:
                rows += _accuracy(total, protocol, streaked, found)
        rows += _families(sums, [condition for condition in conditions if condition.endswith(f"|{protocol}")])
    for family in dict.fromkeys(condition.split("|")[0] for condition in conditions):
        of_family = [condition for condition in conditions if condition.startswith(f"{family}|")]
        rows += _covariances(pooled(sums, of_family), family)
    rows.append(_tail(pooled(sums, conditions), "all families"))
    return Table(
        "Goals",
        ("figure", "value", "goal", "met"),
        [*rows, *_detection(pooled(sums, conditions))],
        "chi² / 3n compares the errors with the stated covariances; 1 is consistent.",
    )


def _accuracy(total: Sums, protocol: str, streaked: bool, found: float) -> list[Sequence[Cell]]:
    where = f"{protocol}, {'with' if streaked else 'without'} streaks on posts"
    rms_um = 1e3 * sqrt(of_method(total, Method.OURS, "error2") / found)
    rows: list[Sequence[Cell]] = []
    if protocol in RMS_UM:
        rows.append(_at_most(f"rms µm, {where}", rms_um, RMS_UM[protocol][streaked]))
    share_um = percentile_um(total, Method.OURS, found)
    if streaked and share_um is not None and protocol in SHARE_95_UM:
        rows.append(_at_most(f"95th percentile µm, {where}", share_um, SHARE_95_UM[protocol]))
    return rows


def _families(sums: Mapping[str, Sums], conditions: Sequence[str]) -> list[Sequence[Cell]]:
    """What each family of one protocol must meet: pooled, a bad one would hide behind a good one."""
    rows: list[Sequence[Cell]] = []
    for condition in conditions:
        total, where = sums[condition], ", ".join(condition.split("|")[::-1])
        found = of_method(total, Method.OURS, "found")
        if not found:
            continue
        if condition.split("|")[0] in COVERED:
            rms_um = 1e3 * sqrt(of_method(total, Method.OURS, "error2") / found)
            rows.append(_at_most(f"rms µm, {where}", rms_um, COVERED_RMS_UM))
        largest_um = percentile_um(total, Method.OURS, found, 1.0)
        if largest_um is not None:
            rows.append(_at_most(f"largest error µm, {where}", largest_um, LARGEST_UM))
    return rows


def _covariances(total: Sums, family: str) -> list[Sequence[Cell]]:
    """Whether the stated covariances of a family are right, all protocols: one alone has too few spheres."""
    found = of_method(total, Method.OURS, "found")
    if not found:
        return []
    (low, high), chi2 = CHI2, of_method(total, Method.OURS, "chi2") / (3.0 * found)
    spheres = int(of_method(total, Method.OURS, "spheres"))
    enough = _word(spheres >= LEAST_OF_A_FAMILY)
    return [
        (f"spheres, {family}", spheres, f"at least {LEAST_OF_A_FAMILY}", enough),
        (f"chi² / 3n, {family}", chi2, f"{low:g} to {high:g}", _word(low <= chi2 <= high)),
        _tail(total, family),
    ]


def _tail(total: Sums, where: str) -> Sequence[Cell]:
    from scipy.stats import binom  # half a second

    found, beyond = (of_method(total, Method.OURS, key) for key in ("found", "tail"))
    most = float(binom.ppf(1.0 - CHANCE, int(found), TAIL))
    return _at_most(f"errors outside 99 %, {where}", int(beyond), most)


def _detection(total: Sums) -> list[Sequence[Cell]]:
    spheres, missed, false, large = (
        of_method(total, Method.OURS, key) for key in ("spheres", "missed", "false", "large")
    )
    objects, volumes = total.get("objects", 0.0), total.get("volumes", 0.0)
    rows: list[Sequence[Cell]] = [
        ("spheres", int(spheres), f"at least {LEAST_SPHERES}", _word(spheres >= LEAST_SPHERES)),
        ("other objects", int(objects), f"at least {LEAST_OBJECTS}", _word(objects >= LEAST_OBJECTS)),
        ("volumes", int(volumes), f"at least {LEAST_VOLUMES}", _word(volumes >= LEAST_VOLUMES)),
        ("missed", int(missed), "0", _word(missed == 0)),
        ("false", int(false), "0", _word(false == 0)),
    ]
    if large:
        share = 100.0 * of_method(total, Method.OURS, "large flagged") / large
        goal = f"at least {FLAGGED_PERCENT:g}"
        rows.append(("errors above 0.1 mm flagged, %", share, goal, _word(share >= FLAGGED_PERCENT)))
    return rows


def _at_most(what: str, value: float, most: float) -> tuple[Cell, ...]:
    return (what, value, f"at most {most:g}", _word(value <= most))


def _word(met: bool) -> str:
    return "yes" if met else "NO"
