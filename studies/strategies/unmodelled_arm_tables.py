"""Tables of the prediction on wrong arms and with a wrong tracker: coverage, errors and refusals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping

from studies.accuracy.scene import FINE_CT_MM
from studies.campaign import bounds
from studies.campaign.study import Cell, Sums, Table, yes_or_no
from studies.strategies import distorted_tracker
from studies.strategies.distorted_tracker import GOAL
from studies.strategies.judged_arm import RESIDUAL, WITHOUT_COVARIANCE, WITHOUT_SCAN
from studies.strategies.unmodelled_arm import ARMS, CALIBRATED, MOVES

ALL_EFFECTS = "all of them"


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate coverage and refusals for each effect and kind of arm, the gates, then the moves."""
    content = sums.get(ARMS, {})
    by_effect = _total(content, lambda effect, kind, _: (effect, kind))
    by_kind = _total(content, lambda _, kind, __: (ALL_EFFECTS, kind))
    by_strategy = _total(content, lambda effect, kind, strategy: (effect, kind, strategy))
    return [
        Table.of(
            "Arms with effects that the model lacks",
            [_coverage_row(key, total) for key, total in {**by_effect, **by_kind}.items()],
            "All strategies and numbers of spheres together. Accepted: not refused; errors, limits and "
            "coverage are of the accepted trials. Arms: those with an accepted trial, once for each effect. "
            f"Within: the error is within the 95 % limit shown to the operator. {bounds.CAPTION}: from the "
            "scatter of the arms (Student); trials of one arm are not independent. As stated: within the "
            "limit before the residual widens it. Without unnoticed changes: within the widened limit "
            "without the shares for changes of head, cart and guide too small to be noticed. CT error "
            f"{FINE_CT_MM} mm.",
        ),
        Table.of(
            "What refuses",
            [_refusal_row(key, total) for key, total in by_effect.items()],
            "In % of all trials. Without covariance: what PRO-007 would refuse if it took an identified "
            "arm's error as independent from sphere to sphere, in the size that the record states. Without "
            "the scan: if it made no allowance for a scan that is stretched as a whole.",
        ),
        Table.of(
            "By strategy",
            [_strategy_row(key, total) for key, total in by_strategy.items()],
            "Each strategy has a third of the arms.",
        ),
        distorted_tracker.tabulate(
            {key.partition("|")[2]: one for key, one in sums.items() if key.startswith(f"{MOVES}|")}
        ),
    ]


def _coverage_row(key: tuple[str, ...], total: Sums) -> dict[str, Cell]:
    effect, kind = key
    used, trials = total["used"], total["trials"]
    inside = bounds.share_by_group(
        total["inside"], used, total["inside2"], total["inside used"], total["used2"], total["arms used"]
    )
    met = "" if inside is None else yes_or_no(inside.value >= 100.0 * GOAL)
    return {
        "effect": effect,
        "arm": kind,
        "trials": round(trials),
        "refused %": 100.0 * _refused(total) / trials,
        "accepted": round(used),
        "arms": round(total["arms used"]),
        "mean error mm": _share(total, "error"),
        "mean limit mm": _share(total, "limit"),
        "within %": None if inside is None else inside.value,
        bounds.column("within"): "" if inside is None else inside.text,
        "as stated %": _percent(total, "inside stated"),
        "without unnoticed changes %": _percent(total, "inside seen"),
        "widened %": _percent(total, "widened"),
        f"at least {100 * GOAL:.0f} %": met,
    }


def _refusal_row(key: tuple[str, ...], total: Sums) -> dict[str, Cell]:
    effect, kind = key

    def percent(quantity: str) -> float:
        return 100.0 * total[quantity] / total["trials"]

    calibration = sum(percent(code) for code in total if code.startswith("CAL-"))
    identified = kind == CALIBRATED
    return {
        "effect": effect,
        "arm": kind,
        "calibration": calibration,
        "residual (PRO-007)": percent(RESIDUAL),
        "gauge (TOOL-005)": percent("TOOL-005"),
        "PRO-007 without covariance": percent(WITHOUT_COVARIANCE) if identified else None,
        "PRO-007 without the scan": percent(WITHOUT_SCAN) if identified else None,
    }


def _strategy_row(key: tuple[str, ...], total: Sums) -> dict[str, Cell]:
    effect, kind, strategy = key
    return {
        "effect": effect,
        "arm": kind,
        "strategy": strategy,
        "refused %": 100.0 * _refused(total) / total["trials"],
        "accepted": round(total["used"]),
        "mean error mm": _share(total, "error"),
        "mean limit mm": _share(total, "limit"),
        "within %": _percent(total, "inside"),
    }


def _refused(total: Sums) -> float:
    return sum(value for name, value in total.items() if "-" in name)  # codes alone have a hyphen


def _share(total: Sums, quantity: str) -> float | None:
    return total[quantity] / total["used"] if total["used"] else None


def _percent(total: Sums, quantity: str) -> float | None:
    share = _share(total, quantity)
    return None if share is None else 100.0 * share


def _total(
    content: Mapping[str, float], key_of: Callable[[str, str, str], tuple[str, ...]]
) -> dict[tuple[str, ...], Sums]:
    totals: dict[tuple[str, ...], Sums] = defaultdict(lambda: defaultdict(float))
    for effect, kind, strategy, quantity, value in _entries(content):
        totals[key_of(effect, kind, strategy)][quantity] += value
    return totals


def _entries(content: Mapping[str, float]) -> Iterator[tuple[str, str, str, str, float]]:
    for key, value in content.items():
        effect, kind, strategy, _, quantity = key.split("|")
        yield effect, kind, strategy, quantity, value
