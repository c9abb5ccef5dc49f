"""Figures of whole cases: one row a condition, and strategies compared target by target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest, wilcoxon

from benchmarks.whole_cases.block import TARGETS
from benchmarks.whole_cases.cases import FINISHED, Attempt, is_settled
from benchmarks.whole_cases.conditions import COMPARED_WITH, list_conditions

CONFIDENCE = 0.95  # of the interval of a coverage
HEADER = (
    "| cases of | strategy | cases | refused | again | targets | mean mm | largest mm | predicted, rms mm "
    "| within the 95 % limit | image pairs | theatre s |"
)
PAIRED_HEADER = (
    f"| cases of | strategy minus `{COMPARED_WITH}` | targets | mean mm | better | sign p | Wilcoxon p "
    "| cases | better | sign p |"
)

Figures = dict[str, Any]


def summarize(attempts: Sequence[Attempt]) -> dict[str, dict[str, Figures]]:
    """Return all figures by group and strategy, those of the comparison under `paired`."""
    found: dict[str, dict[str, Figures]] = {}
    conditions = _by_condition(attempts)
    for name, own in conditions.items():
        group, strategy = name.split(" ")
        figures = _measure(own, _targets_of(name))
        other = conditions.get(f"{group} {COMPARED_WITH}")
        if other is not None and strategy != COMPARED_WITH:
            figures["paired"] = _compare(own, other)
        found.setdefault(group, {})[strategy] = figures
    return found


def tabulate(summary: Mapping[str, Mapping[str, Figures]]) -> Iterator[str]:
    """Yield the lines of two Markdown tables, of the figures and of the comparison."""
    yield from _begin(HEADER)
    rows = [(group, name, one) for group, own in summary.items() for name, one in own.items()]
    for group, name, one in rows:
        yield (
            f"| {group} | `{name}` | {one['cases']} | {one['refused']} | {one['again']} "
            f"| {one['reached']} of {one['planned']} | {_row(one)} |"
        )
    yield ""
    yield from _begin(PAIRED_HEADER)
    for group, name, one in rows:
        if (paired := one.get("paired")) and paired["targets"]:
            yield (
                f"| {group} | `{name}` | {paired['targets']} | {paired['mean_mm']:+.4f} "
                f"| {paired['better']} | {paired['sign_p']:.2g} | {paired['wilcoxon_p']:.2g} "
                f"| {paired['cases']} | {paired['cases_better']} | {paired['cases_sign_p']:.2g} |"
            )


def _begin(header: str) -> Iterator[str]:
    yield header
    yield "|" + "---|" * (header.count("|") - 1)


def _row(one: Figures) -> str:
    if not one["reached"]:
        return " | ".join([""] * 6)
    low, high = one["coverage_interval"]
    return (
        f"{one['mean_mm']:.3f} | {one['largest_mm']:.3f} | {one['predicted_least_mm']:.2f}-"
        f"{one['predicted_most_mm']:.2f} | {one['within']} of {one['reached']} ({low:.0%}-{high:.0%}) "
        f"| {one['looks_mean']:.1f} | {one['theatre_mean_s']:.0f}"
    )


def _by_condition(attempts: Sequence[Attempt]) -> dict[str, dict[int, list[Attempt]]]:
    """Return the attempts of each settled case, by condition and seed."""
    found: dict[str, dict[int, list[Attempt]]] = {}
    for one in attempts:
        found.setdefault(one["case"], {}).setdefault(one["seed"], []).append(one)
    return {
        name: {seed: own for seed, own in seeds.items() if is_settled(own)} for name, seeds in found.items()
    }


def _targets_of(name: str) -> int:
    """Return the targets of each case of a condition, of the default scene for one that is no more."""
    return next((one.targets for one in list_conditions() if one.name == name), TARGETS)


def _measure(cases: Mapping[int, Sequence[Attempt]], targets: int) -> Figures:
    last = [attempts[-1] for attempts in cases.values()]
    finished = [one for one in last if one["outcome"] in FINISHED]
    figures: Figures = {
        "cases": len(cases),
        "refused": len(last) - len(finished),
        "again": sum(len(own) > 1 and own[-1]["outcome"] in FINISHED for own in cases.values()),
        "planned": targets * len(cases),
        "reached": sum(len(one["errors_mm"]) for one in finished),
    }
    if not figures["reached"]:
        return figures
    errors, predicted, limits = (
        np.concatenate([one[column] for one in finished])
        for column in ("errors_mm", "predicted_mm", "limits_mm")
    )
    within = int((errors <= limits).sum())
    interval = binomtest(within, len(errors)).proportion_ci(CONFIDENCE)
    return figures | {
        "mean_mm": float(errors.mean()),
        "rms_mm": float(np.sqrt((errors**2).mean())),
        "largest_mm": float(errors.max()),
        "predicted_least_mm": float(predicted.min()),
        "predicted_most_mm": float(predicted.max()),
        "predicted_rms_mm": float(np.sqrt((predicted**2).mean())),
        "within": within,
        "coverage": within / len(errors),
        "coverage_interval": [float(interval.low), float(interval.high)],
        "looks_mean": float(np.mean([one["looks"] for one in finished])),
        "localizations_mean": float(np.mean([one["localizations"] for one in finished])),
        "theatre_mean_s": float(np.mean([one["theatre_s"] for one in finished])),
        "processor_mean_s": float(np.mean([one["processor_s"] for one in finished])),
    }


def _compare(cases: Mapping[int, Sequence[Attempt]], others: Mapping[int, Sequence[Attempt]]) -> Figures:
    """Compare errors at the targets that both reached, and their means over each case."""
    own, other = _errors_mm(cases), _errors_mm(others)
    both = sorted(own.keys() & other.keys())
    differences_mm = np.array([own[one] - other[one] for one in both])
    seeds = sorted({seed for seed, _ in both})
    means_mm = np.array(
        [np.mean([d for d, (seed, _) in zip(differences_mm, both, strict=True) if seed == s]) for s in seeds]
    )
    if not len(both):
        return {"targets": 0}
    return {
        "targets": len(both),
        "mean_mm": float(differences_mm.mean()),
        "better": int((differences_mm < 0.0).sum()),
        "sign_p": _sign_p(differences_mm),
        "wilcoxon_p": float(wilcoxon(differences_mm).pvalue) if differences_mm.any() else 1.0,
        "cases": len(seeds),
        "cases_better": int((means_mm < 0.0).sum()),
        "cases_sign_p": _sign_p(means_mm),
    }


def _errors_mm(cases: Mapping[int, Sequence[Attempt]]) -> dict[tuple[int, str], float]:
    return {
        (seed, target): error_mm
        for seed, attempts in cases.items()
        if attempts[-1]["outcome"] in FINISHED
        for target, error_mm in zip(attempts[-1]["targets"], attempts[-1]["errors_mm"], strict=True)
    }


def _sign_p(differences: np.ndarray) -> float:
    """Return the two-sided probability of the sign test; equal ones are no evidence."""
    less, more = int((differences < 0.0).sum()), int((differences > 0.0).sum())
    return float(binomtest(less, less + more).pvalue) if less + more else 1.0
