"""Tables, plots and goals of the localization study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.registration.error_theory import fle_from_fre_mm, fle_of_one_space_mm
from studies.campaign import bounds
from studies.campaign.plots import bars
from studies.campaign.study import (
    GOALS,
    Cell,
    Sums,
    Table,
    judge,
    judge_at_least,
    judge_at_most,
    judge_within,
    pool,
)
from studies.localization.study import (
    AUTOMATIC,
    BIN_MM,
    COVERED,
    FRAMES,
    JUDGING,
    OURS,
    PERSON,
    REFINED,
    STREAKED,
    TAIL,
)
from studies.thesis_tables import HUMAN_OPERATORS, LINE_FIT, OPERATORS, SPHERE_FIT, TABLE_2, TABLE_3

SPHERES = 4  # of the frame
IN_THE_THESIS: dict[str, str] = {
    LOCALIZERS[Localizer.THESIS_LINE].method: LINE_FIT,
    LOCALIZERS[Localizer.THESIS_SPHERE].method: SPHERE_FIT,
}
RMS_UM = {"good": (10.0, 35.0), "poor": (20.0, 50.0)}  # without and with streaks on posts
COVERED_RMS_UM = 40.0  # half buried
LARGEST_UM = 150.0
SHARE_95_UM = {"good": 50.0, "poor": 70.0}  # with streaks
CHI2 = (0.7, 1.4)
LEAST_OF_A_FAMILY = 60  # spheres: right covariances leave the range once in 900 times (20: once in 17)
CHANCE = 1e-3  # of right covariances to miss a goal for the tail
LEAST_SPHERES, LEAST_OBJECTS, LEAST_VOLUMES = 500, 500, 100
FLAGGED_PERCENT = 90.0  # of errors above 0.1 mm


Condition = tuple[str, str]  # family and protocol


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate pooled results, results by family, the errors of the thesis' tables 2 and 3, and the goals.

    The goals are left out if no evaluation families were scanned.
    """
    scans, frames = _split_scans(sums)
    of_frames = [_tabulate_fle(frames)] if frames else []
    if not scans:
        return of_frames
    held = goals(sums)
    together: list[Mapping[str, Cell]] = []
    for protocol in _list_protocols(scans):
        for words, streaked in (("without", False), ("with", True)):
            total = _pool_scans(scans, protocol=protocol, streaked=streaked)
            together += _make_rows(f"{words} streaks on posts", protocol, total)
    single = [
        row for (family, protocol), total in scans.items() for row in _make_rows(family, protocol, total)
    ]
    found = [
        Table.of(
            "Localization, families together",
            together,
            "Errors are 3-D. chi² / 3n is 1 when the stated covariances are right; the thesis' methods "
            "have none, so its reported FLE is used; user methods have none. CRB: a homogeneous ball "
            f"in white noise. {_describe_cut_spheres(_pool_scans(scans))} {bounds.NOTE} "
            "Spheres of one scan count as independent. "
            "False ones: Poisson, in as many scans.",
        ),
        Table.of(
            "Localization by family",
            single,
            "Goals: 10 µm good, 20 poor; 35 and 50 with streaks; 40 under a bandage.",
        ),
    ]
    return [*found, *of_frames, *(() if held is None else (held,))]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot the rms error by family and method for each protocol, and the frame's FLE."""
    pictures = {}
    scans, frames = _split_scans(sums)
    for protocol in _list_protocols(scans):
        groups = {
            family: {
                method: _rms_um(total, method)
                for method in methods_of(total)
                if sum_of_method(total, method, "found")
            }
            for (family, of_scan), total in scans.items()
            if of_scan == protocol
        }
        pictures[f"error-{protocol}.png"] = bars(
            f"3-D error, {protocol} protocol", "rms, µm", groups, x_label="family of scans"
        )
    if frames:
        pictures["fle.png"] = bars("FLE, four spheres of the x-shaped frame", "mm", _make_fle_bars(frames))
    return pictures


def goals(sums: Mapping[str, Sums]) -> Table | None:
    """Compare our results with the goals, or return None if no evaluation families were scanned."""
    scans = {
        condition: total for condition, total in _split_scans(sums)[0].items() if condition[0] in JUDGING
    }
    if not scans:
        return None
    rows: list[Sequence[Cell]] = []
    for protocol in _list_protocols(scans):
        for streaked in (False, True):
            total = _pool_scans(scans, protocol=protocol, streaked=streaked)
            if found := sum_of_method(total, OURS, "found"):
                rows += _judge_accuracy(total, protocol, streaked, found)
        for (family, of_scan), total in scans.items():
            if of_scan == protocol:
                rows += _judge_single(total, family, protocol)
    for family in dict.fromkeys(family for family, _ in scans):
        rows += _judge_covariances(_pool_scans(scans, family=family), family)
    everything = _pool_scans(scans)
    rows.append(_judge_tail(everything, "all families"))
    return Table(
        "Goals",
        GOALS,
        [*rows, *_judge_detection(everything)],
        "chi² / 3n compares the errors with the stated covariances; 1 is consistent.",
    )


def _split_scans(sums: Mapping[str, Sums]) -> tuple[dict[Condition, Sums], Sums]:
    """Separate the sums of volumes, by condition, from the sums of all frame sets."""
    scans: dict[Condition, Sums] = {}
    frames: list[Sums] = []
    for condition, content in sums.items():
        family, protocol = condition.split("|")
        if family == FRAMES:
            frames.append(content)
        else:
            scans[family, protocol] = content
    return scans, pool(frames)


def _list_protocols(scans: Mapping[Condition, Sums]) -> list[str]:
    return list(dict.fromkeys(protocol for _, protocol in scans))


def _pool_scans(
    scans: Mapping[Condition, Sums],
    *,
    family: str | None = None,
    protocol: str | None = None,
    streaked: bool | None = None,
) -> Sums:
    return pool(
        content
        for (of_family, of_protocol), content in scans.items()
        if family in (None, of_family)
        and protocol in (None, of_protocol)
        and streaked in (None, of_family in STREAKED)
    )


def _make_fle_bars(total: Sums) -> dict[str, dict[str, float]]:
    """Return our FLE figures next to the thesis', omitting any missing ones."""
    groups: dict[str, dict[str, float]] = {}
    for who, _, truth_mm, table_2_mm, _, pair_mm, table_3_mm in _tabulate_fle(total).rows:
        named = {
            "to the truth": truth_mm,
            "thesis, table 2": table_2_mm,
            "between scans": pair_mm,
            "thesis, table 3": table_3_mm,
        }
        short = str(who).replace("thesis-", "").replace("person's picks ", "picks\n")
        groups[short] = {name: value for name, value in named.items() if isinstance(value, float)}
    return groups


def _make_rows(family: str, protocol: str, total: Sums) -> list[Mapping[str, Cell]]:
    rows: list[Mapping[str, Cell]] = []
    for method in methods_of(total):
        spheres, found = sum_of_method(total, method, "spheres"), sum_of_method(total, method, "found")
        if not spheres:
            continue
        false = bounds.number(sum_of_method(total, method, "false"))
        rms = _rms_um(total, method) if found else None
        bound_mm = sqrt(total["bound2"] / total["volumes"])
        with_covariances = found and method in AUTOMATIC
        rows.append(
            {
                "family": family,
                "protocol": protocol,
                "method": method,
                "spheres": int(spheres),
                **bounds.cells("found %", bounds.percent(found, spheres)),
                "false": int(false.value),
                bounds.column("false"): false.text,
                "rms µm": None if rms is None else rms.value,
                bounds.column("rms"): None if rms is None else rms.text,
                "95th percentile µm": percentile_um(total, method, found),
                "rms / CRB": None if rms is None else 1e-3 * rms.value / bound_mm,
                "chi² / 3n": sum_of_method(total, method, "chi2") / (3.0 * found)
                if with_covariances
                else None,
            }
        )
    return rows


def _rms_um(total: Sums, method: str) -> bounds.Bounded:
    sums = (1e6 * sum_of_method(total, method, "error2"), 1e12 * sum_of_method(total, method, "error4"))
    return bounds.root_mean_square(*sums, sum_of_method(total, method, "found"))


def methods_of(total: Sums) -> list[str]:
    """Return the built-in methods in fixed order, followed by the user methods."""
    there = [key.partition("|")[0] for key in total if key.endswith("|spheres")]
    known = [method for method in AUTOMATIC if method in there]
    return [*known, *(one for one in there if one not in known)]


def percentile_um(total: Sums, method: str, found: float, share: float = 0.95) -> float | None:
    """Return the upper edge of the histogram bin in which the share is reached, in µm."""
    prefix = f"{method}|bin "
    bins = sorted((int(key[len(prefix) :]), count) for key, count in total.items() if key.startswith(prefix))
    reached = 0.0
    for number, count in bins:
        reached += count
        if reached >= share * found:
            return 1e3 * BIN_MM * (number + 1)
    return None


def _describe_cut_spheres(total: Sums) -> str:
    cut, found, large, flagged = (
        int(sum_of_method(total, OURS, key)) for key in ("cut", "cut found", "large", "large flagged")
    )
    return (
        f"Of {cut} further spheres cut by the field of view, ours finds {found}. Of {large} of our errors"
        f" above 0.1 mm, {flagged} are flagged."
    )


def _tabulate_fle(total: Sums) -> Table:
    """Tabulate FLE derived from FRE: by eq. 36 to the frame's coordinates, by eq. 38 between scans."""
    rows: list[dict[str, Cell]] = []
    people = [f"{PERSON} {number}" for number in range(1, len(OPERATORS) + 1)]
    known = [*AUTOMATIC, REFINED, *people]
    own = [
        who for key in total if key.endswith("|truth runs") and (who := key.partition("|")[0]) not in known
    ]
    for who in [*known, *own]:
        runs, pairs = total.get(f"{who}|truth runs", 0.0), total.get(f"{who}|pair runs", 0.0)
        if not (runs and pairs):
            continue
        truth_mm = fle_from_fre_mm(sqrt(total[f"{who}|truth fre2"] / runs), SPHERES)
        pair_mm = fle_of_one_space_mm([sqrt(total[f"{who}|pair fre2"] / pairs)], SPHERES)
        person = who in people
        named = OPERATORS[people.index(who)] if person else IN_THE_THESIS.get(who, "")
        table_2 = TABLE_2.get(HUMAN_OPERATORS if person else named)
        table_3 = TABLE_3.get(named)
        rows.append(
            {
                "who": who,
                "scans": int(runs),
                "FLE mm, truth": truth_mm,
                "thesis, table 2": None if table_2 is None else table_2.printed_mm,
                "pairs": int(pairs),
                "FLE mm, pairs": pair_mm,
                "thesis, table 3": None if table_3 is None else table_3.printed_mm,
            }
        )
    return Table.of(
        "FLE as in tables 2 and 3 of the thesis",
        rows,
        "Four spheres of the x-shaped frame. People are simulated with the FLE of the thesis' "
        "operators: their rows check eq. 36 and 38, not people. Real scanners add errors of "
        "scale and table feed.",
    )


def sum_of_method(total: Sums, method: str, key: str) -> float:
    return total.get(f"{method}|{key}", 0.0)


def _judge_accuracy(total: Sums, protocol: str, streaked: bool, found: float) -> list[Sequence[Cell]]:
    condition_text = f"{protocol}, {'with' if streaked else 'without'} streaks on posts"
    rms_um = 1e3 * sqrt(sum_of_method(total, OURS, "error2") / found)
    rows: list[Sequence[Cell]] = []
    if protocol in RMS_UM:
        rows.append(judge_at_most(f"rms µm, {condition_text}", rms_um, RMS_UM[protocol][streaked]))
    share_um = percentile_um(total, OURS, found)
    if streaked and share_um is not None and protocol in SHARE_95_UM:
        rows.append(judge_at_most(f"95th percentile µm, {condition_text}", share_um, SHARE_95_UM[protocol]))
    return rows


def _judge_single(total: Sums, family: str, protocol: str) -> list[Sequence[Cell]]:
    """Judge a single family and protocol, since pooling could mask a bad one."""
    found = sum_of_method(total, OURS, "found")
    if not found:
        return []
    rows: list[Sequence[Cell]] = []
    if family in COVERED:
        rms_um = 1e3 * sqrt(sum_of_method(total, OURS, "error2") / found)
        rows.append(judge_at_most(f"rms µm, {protocol}, {family}", rms_um, COVERED_RMS_UM))
    largest_um = percentile_um(total, OURS, found, 1.0)
    if largest_um is not None:
        rows.append(judge_at_most(f"largest error µm, {protocol}, {family}", largest_um, LARGEST_UM))
    return rows


def _judge_covariances(total: Sums, family: str) -> list[Sequence[Cell]]:
    """Judge a family's stated covariances over all protocols, since one has too few spheres."""
    found = sum_of_method(total, OURS, "found")
    if not found:
        return []
    chi2 = sum_of_method(total, OURS, "chi2") / (3.0 * found)
    spheres = int(sum_of_method(total, OURS, "spheres"))
    return [
        judge_at_least(f"spheres, {family}", spheres, LEAST_OF_A_FAMILY),
        judge_within(f"chi² / 3n, {family}", chi2, CHI2),
        _judge_tail(total, family),
    ]


def _judge_tail(total: Sums, condition_text: str) -> Sequence[Cell]:
    from scipy.stats import binom  # half a second

    found, in_tail = (sum_of_method(total, OURS, key) for key in ("found", "tail"))
    most = float(binom.ppf(1.0 - CHANCE, int(found), TAIL))
    return judge_at_most(f"errors outside 99 %, {condition_text}", int(in_tail), most)


def _judge_detection(total: Sums) -> list[Sequence[Cell]]:
    spheres, missed, false, large = (
        sum_of_method(total, OURS, key) for key in ("spheres", "missed", "false", "large")
    )
    objects, volumes = total.get("objects", 0.0), total.get("volumes", 0.0)
    rows = [
        judge_at_least("spheres", int(spheres), LEAST_SPHERES),
        judge_at_least("other objects", int(objects), LEAST_OBJECTS),
        judge_at_least("volumes", int(volumes), LEAST_VOLUMES),
        judge("missed", int(missed), "0", missed == 0),
        judge("false", int(false), "0", false == 0),
    ]
    if large:
        share = 100.0 * sum_of_method(total, OURS, "large flagged") / large
        rows.append(judge_at_least("errors above 0.1 mm flagged, %", share, FLAGGED_PERCENT))
    return rows
