"""Whole cases are drawn by a rule, none is left out of their table, and strategies are compared in pairs."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from benchmarks.whole_cases.block import draw_block
from benchmarks.whole_cases.cases import is_settled
from benchmarks.whole_cases.conditions import list_conditions
from benchmarks.whole_cases.page import BEGIN, END, FIGURES_FILE, PAGE, write_page
from benchmarks.whole_cases.table import summarize, tabulate
from procedures.strategies.catalogue import STRATEGIES

COMMIT = "0123456789abcdef0123456789abcdef01234567"


def case(
    seed: int, *errors_mm: float, strategy: str = "ocs", attempt: int = 1, **more: Any
) -> dict[str, Any]:
    return {
        "case": f"uncalibrated {strategy}",
        "seed": seed,
        "attempt": attempt,
        "outcome": "done",
        "error": None,
        "targets": [f"T{number + 1}" for number in range(len(errors_mm))],
        "errors_mm": list(errors_mm),
        "predicted_mm": [0.2] * len(errors_mm),
        "limits_mm": [0.35] * len(errors_mm),
        "looks": 40,
        "localizations": 15,
        "theatre_s": 100.0,
        "processor_s": 30.0,
    } | more


def refused(seed: int, attempt: int, code: str = "PRO-007") -> dict[str, Any]:
    return case(seed, attempt=attempt, outcome="failed", error={"code": code, "what": ""})


def rows(*attempts: dict[str, Any]) -> list[str]:
    return [line for line in tabulate(summarize(attempts)) if line.startswith("| uncalibrated")]


def test_a_block_follows_from_its_commit_alone_and_passes_over_what_the_commit_names() -> None:
    block = draw_block(COMMIT, lambda _seed: False)
    assert block == draw_block(COMMIT, lambda _seed: False)
    assert len(set(block)) == 20
    assert all(1000 <= seed <= 65535 for seed in block)
    assert draw_block(COMMIT, lambda seed: seed == block[0])[:19] == block[1:]
    assert not set(block) & set(draw_block(COMMIT[::-1], lambda _seed: False))


def test_a_short_commit_draws_no_block() -> None:
    with pytest.raises(ValueError, match="40 lower-case"):
        draw_block(COMMIT[:12])


def test_every_strategy_of_the_catalogue_is_run_calibrated_and_not_beginning_with_the_default() -> None:
    conditions = list_conditions()
    assert conditions[0].name == "uncalibrated ocs"
    for group in ("uncalibrated", "calibrated", "seating_uncalibrated", "seating_calibrated"):
        own = [one.strategy for one in conditions if one.group == group]
        assert sorted(own) == sorted(one.name for one in STRATEGIES)
    assert len({one.name for one in conditions}) == len(conditions)


@pytest.mark.parametrize(
    ("attempts", "settled"),
    [
        ([], False),
        ([case(7, 0.1)], True),
        ([refused(7, 1)], False),
        ([refused(7, 1), refused(7, 2)], True),
        ([refused(7, 1, "KUK-004"), refused(7, 2)], False),
        ([refused(7, 1, "KUK-004"), case(7, 0.1, attempt=2)], True),
    ],
)
def test_an_error_is_the_methods_when_it_comes_again(attempts: list[dict[str, Any]], settled: bool) -> None:
    assert is_settled(attempts) is settled


def test_a_refused_case_counts_as_refused_and_its_targets_as_not_reached() -> None:
    (row,) = rows(case(100, 0.1, 0.2, 0.6), refused(101, 1), refused(101, 2))
    assert row.startswith(
        "| uncalibrated | `ocs` | 2 | 1 | 0 | 3 of 6 | 0.300 | 0.600 | 0.20-0.20 | 2 of 3 ("
    )


def test_a_case_that_only_failed_once_counts_as_done_and_is_counted_apart() -> None:
    (row,) = rows(refused(100, 1), case(100, 0.1, 0.2, 0.3, attempt=2))
    assert row.startswith("| uncalibrated | `ocs` | 1 | 0 | 1 | 3 of 3 |")


def test_a_strategy_whose_cases_were_all_refused_keeps_its_row() -> None:
    (row,) = rows(refused(100, 1), refused(100, 2))
    assert row.startswith("| uncalibrated | `ocs` | 1 | 1 | 0 | 0 of 3 |")


def test_strategies_are_compared_at_the_targets_that_both_reached() -> None:
    default = [case(1, 0.2, 0.3, 0.4), case(2, 0.1, 0.1)]
    other = [case(1, 0.1, 0.2, 0.5, strategy="best"), case(2, 0.05, strategy="best")]
    paired = summarize([*default, *other])["uncalibrated"]["best"]["paired"]
    assert (paired["targets"], paired["better"]) == (4, 3)
    assert paired["mean_mm"] == pytest.approx((-0.1 - 0.1 + 0.1 - 0.05) / 4)
    assert (paired["cases"], paired["cases_better"]) == (2, 2)
    assert paired["sign_p"] == pytest.approx(0.625)  # 3 of 4, two-sided: 10 of 16


def test_each_row_of_the_page_has_an_entry_that_gives_it(tmp_path: Path) -> None:
    page, figures = tmp_path / PAGE, tmp_path / FIGURES_FILE
    page.parent.mkdir(parents=True)
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    other = [case(1, 0.1, 0.2, 0.5, strategy="best"), refused(2, 1), refused(2, 2)]
    summary = summarize([case(1, 0.2, 0.3, 0.4), *other])
    write_page(summary, "kept.json", "the command", tmp_path)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    entries = tomllib.loads(figures.read_text())["figure"]
    assert [one["states"] in text for one in entries] == [True, True]
    assert "| 3 of 3 | 0.267, 0.500 | 2 of 3 | -0.033 | 2 of 3 | 40 | 100 |" in entries[1]["states"]
    assert entries[1]["values"][3:5] == ["uncalibrated.best.planned", "uncalibrated.best.mean_mm"]
