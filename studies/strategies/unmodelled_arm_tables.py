"""Tables of the prediction on wrong arms and with a wrong tracker: coverage, errors and refusals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from studies.accuracy.scene import FINE_CT_MM
from studies.campaign.study import Cell, Sums, Table, yes_or_no
from studies.strategies import distorted_tracker
from studies.strategies.distorted_tracker import GOAL
from studies.strategies.unmodelled_arm import ARMS, MOVES


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate coverage, mean error and refusals for each effect and kind of arm, then the moves."""
    totals: dict[tuple[str, str, str], Sums] = defaultdict(lambda: defaultdict(float))
    for key, quantity, value in _entries(sums.get(ARMS, {})):
        totals[key][quantity] += value
    rows: list[dict[str, Cell]] = []
    for (effect, kind, strategy), total in totals.items():
        used, trials = total["used"], total["trials"]
        codes = {code: share for code, share in sorted(total.items()) if "-" in code}

        def share(quantity: str, total: Sums = total, used: float = used) -> float | None:
            return total[quantity] / used if used else None

        inside = share("inside")
        rows.append(
            {
                "effect": effect,
                "arm": kind,
                "strategy": strategy,
                "trials": round(trials),
                "refused %": 100.0 * sum(codes.values()) / trials,
                "by": ", ".join(f"{code} {100.0 * count / trials:.3g}" for code, count in codes.items()),
                "mean error mm": share("error"),
                "mean limit mm": share("limit"),
                "within %": _percent(inside),
                "as stated %": _percent(share("inside stated")),
                "without unnoticed changes %": _percent(share("inside seen")),
                "widened %": _percent(share("widened")),
                f"at least {100 * GOAL:.0f} %": "refused" if inside is None else yes_or_no(inside >= GOAL),
            }
        )
    return [
        Table.of(
            "Arms with effects that the model lacks",
            rows,
            "3, 4 and 5 free spheres together. Errors, limits and shares are of the trials that were not "
            "refused. Within: the error is within the 95 % limit shown to the operator. As stated: within "
            "the limit before the residual widens it. Without unnoticed changes: within the widened limit "
            "without the shares for changes of head, cart and guide too small to be noticed. The trials of "
            f"one arm are not independent. CT error {FINE_CT_MM} mm.",
        ),
        distorted_tracker.tabulate(
            {key.partition("|")[2]: one for key, one in sums.items() if key.startswith(f"{MOVES}|")}
        ),
    ]


def _entries(content: Mapping[str, float]) -> Iterator[tuple[tuple[str, str, str], str, float]]:
    for key, value in content.items():
        effect, kind, strategy, _, quantity = key.split("|")
        yield (effect, kind, strategy), quantity, value


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
