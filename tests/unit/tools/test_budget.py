"""The budget fails a rise, asks for a lower figure after a gain, and forgives one slow measurement."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from pathlib import Path

import pytest
from budget import BUDGET, Entry, Verdict, check, read_budget, write_budget
from subjects import CALIBRATIONS, Measured, Subject, subjects

CASE = "a case"
BUDGETED = {CASE: [Entry(date(2026, 1, 1), 10.0, CALIBRATIONS, "first measured")]}


def measured(values: Iterator[float]) -> Subject:
    """Build a subject that measures these values, one after the other."""
    return Subject(
        CASE,
        lambda name: [Measured(name, next(values), CALIBRATIONS)],
    )


def judge(*values: float) -> Verdict:
    (verdict,) = check([measured(iter(values))], BUDGETED, lambda _name: None)
    return verdict


@pytest.mark.parametrize(
    ("values", "exceeded", "words"),
    [
        ((10.0,), False, "within"),
        ((11.4,), False, "within"),
        ((12.0, 12.0, 12.0), True, "BEYOND"),
        ((12.0, 10.0, 10.0), False, "within"),
        ((8.0, 8.0, 8.0), False, "lower the budget"),
    ],
)
def test_the_median_counts_where_a_figure_is_out_of_its_budget(
    values: tuple[float, ...], exceeded: bool, words: str
) -> None:
    verdict = judge(*values)
    assert (verdict.exceeded, verdict.words) == (exceeded, words)


def test_a_steady_check_leaves_out_processor_time() -> None:
    both = [Measured(CASE, 99.0, CALIBRATIONS), Measured(f"{CASE}, theatre time", 5.0, "s")]
    subject = Subject(CASE, lambda _name: both[:1], lambda _name: both[1:])
    found = check([subject], BUDGETED, lambda _name: None, steady=True)
    assert [one.measured for one in found] == both[1:]


def test_a_figure_without_a_budget_fails_nothing() -> None:
    (verdict,) = check([measured(iter([10.0]))], {}, lambda _name: None)
    assert not verdict.exceeded


def test_what_is_written_is_read_again_with_the_reason_for_each_rise(tmp_path: Path) -> None:
    path = tmp_path / "budget.toml"
    write_budget([Verdict(Measured(CASE, 10.04, CALIBRATIONS), None)], "first measured", path)
    write_budget([Verdict(Measured(CASE, 10.5, CALIBRATIONS), 10.0)], "not kept: within", path)
    write_budget([Verdict(Measured(CASE, 20.0, CALIBRATIONS), 10.0)], "a second look", path)
    entries = read_budget(path)[CASE]
    assert [(one.value, one.because) for one in entries] == [
        (10.0, "first measured"),
        (20.0, "a second look"),
    ]


def test_every_quick_subject_has_a_budget() -> None:
    budgeted = read_budget(BUDGET)
    assert [one.name for one in subjects() if one.quick and one.name not in budgeted] == []
