"""The table of whole cases leaves none out."""

from __future__ import annotations

from typing import Any

from benchmarks.whole_cases import tabulate


def case(seed: int, outcome: str = "done", *errors_mm: float) -> dict[str, Any]:
    predicted_mm = [0.2] * len(errors_mm)
    return {"calibrated": False, "strategy": "ocs", "seed": seed, "seating_mm": 0.05, "outcome": outcome} | {
        "errors_mm": list(errors_mm),
        "predicted_mm": predicted_mm,
    }


def test_a_refused_case_counts_as_refused_and_its_targets_as_not_reached() -> None:
    *_, row = tabulate([case(100, "done", 0.1, 0.2, 0.3), case(101, "refused")])
    assert row == "| uncalibrated | `ocs` | 2 | 1 | 3 of 6 | 0.200 | 0.300 | 0.20-0.20 |"


def test_a_strategy_whose_cases_were_all_refused_keeps_its_row() -> None:
    *_, row = tabulate([case(100, "refused")])
    assert row == "| uncalibrated | `ocs` | 1 | 1 | 0 of 3 |  |  |  |"


def test_cases_of_another_arm_have_rows_of_their_own() -> None:
    *_, first, second = tabulate([case(100), {**case(100, "done", 0.1), "arm": "ur5e"}])
    assert first.startswith("| uncalibrated | `ocs` | 1 |")
    assert second.startswith("| ur5e, uncalibrated | `ocs` | 1 |")
