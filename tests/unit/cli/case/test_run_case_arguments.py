"""Wrong arguments of `run_case` are refused with the value and what was expected, before anything is run."""

from __future__ import annotations

from pathlib import Path

import pytest
from coded_errors import raises

from procedures.from_python import run_case
from ronna_hw.arguments import WrongArgument


@pytest.mark.filterwarnings("ignore:NumPy was loaded")
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": "x"}, "seed of run_case; expected a whole number, got 'x'"),
        ({"arm": "ur10"}, "arm of run_case; expected 'kr6', 'ur5' or 'ur5e', got 'ur10'"),
        ({"faults": 5}, "no lines of a fault script; expected one line or several.*got 5"),
        ({"faults": ["tracker bump", 5]}, "no lines of a fault script"),
    ],
)
def test_a_wrong_argument_is_refused_with_its_value_and_the_expectation(
    tmp_path: Path, given: dict[str, object], said: str
) -> None:
    with raises(WrongArgument, match=said):
        run_case("mini", out=tmp_path / "runs", progress=False, **given)  # type: ignore[arg-type]
    assert not (tmp_path / "runs").exists()
