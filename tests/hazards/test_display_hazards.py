"""Hazard 6: numbers are shown in full, even extreme ones."""

from __future__ import annotations

import re

import pytest

from procedures.cli.case.display import show_outcome
from procedures.reporting.outcome import FinishedRun, RegistrationOutcome, TargetOutcome
from ronna_hw.command_line import messages

EXTREMES_MM = (0.0004, 0.0006, 9.9996, 12345.6789, 99999.9994)
SHOWN = ("0.000", "0.001", "10.000", "12345.679", "99999.999")
OUTCOME = FinishedRun(
    run="R",
    seed=0,
    strategy="ocs",
    markers=5,
    ct=None,
    registration=RegistrationOutcome(n=5, fre_mm=(0.1,)),
    targets=tuple(
        TargetOutcome(id=f"T{k}", depth_mm=123456.7, predicted_tre_mm=value, application_error_mm=value)
        for k, value in enumerate(EXTREMES_MM)
    ),
    mean_application_error_mm=12345.6789,
    max_application_error_mm=99999.9994,
    late_cycles=0,
    sim_s=1.0,
    wall_s=1.0,
    report="report.html",
)


@pytest.mark.hazard(6)
def test_every_number_of_the_table_is_complete_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    show_outcome(OUTCOME, as_json=False)
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()[1 : 1 + len(SHOWN)]]
    assert rows == [[f"T{k}", "123456.7", shown, shown] for k, shown in enumerate(SHOWN)]


@pytest.mark.hazard(6)
def test_a_target_by_another_strategy_is_named_with_its_error(capsys: pytest.CaptureFixture[str]) -> None:
    first, *others = OUTCOME.targets
    by_nos = first.model_copy(update={"strategy": "nos"})
    show_outcome(OUTCOME.model_copy(update={"targets": (by_nos, *others)}), as_json=False)
    assert "strategy ocs (T0 by nos)" in capsys.readouterr().out


@pytest.mark.hazard(47)
def test_a_limit_beyond_the_margin_is_told_beside_errors_within_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    show_outcome(OUTCOME.model_copy(update={"limit_beyond_margin": {"T1": 0.6554}}), as_json=False)
    assert "T1: 95 % limit beyond the margin, 0.655 mm predicted" in capsys.readouterr().out
    show_outcome(OUTCOME, as_json=False)
    assert "limit" not in capsys.readouterr().out


@pytest.mark.hazard(47)
@pytest.mark.parametrize("as_json", [False, True])
def test_a_needle_farther_from_its_target_than_the_plan_accepts_is_no_success(
    as_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        show_outcome(OUTCOME.model_copy(update={"beyond_margin": {"T2": 9.9996}}), as_json=as_json)
    shown = capsys.readouterr()
    assert ended.value.code == 3
    assert ('"T2":9.9996' in shown.out.replace(" ", "")) if as_json else ("10.00 mm from T2" in shown.out)


@pytest.mark.hazard(6)
@pytest.mark.parametrize("columns", [80, 30])
def test_every_number_is_complete_on_a_normal_and_on_a_narrow_terminal(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, "on_terminal", lambda stream: True)
    monkeypatch.setenv("COLUMNS", str(columns))
    head = ["target", "depth mm", "predicted mm", "error mm"]
    messages.print_table("errors", head, [["T1", "123456.7", shown, shown] for shown in SHOWN])
    numbers = re.findall(r"\d+\.\d+", capsys.readouterr().out)
    assert numbers == [number for shown in SHOWN for number in ("123456.7", shown, shown)]
