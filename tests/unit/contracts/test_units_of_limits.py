"""A limit that a message states names its unit."""

from __future__ import annotations

import pytest
from pydantic import ValidationError
from user_commands import in_this_process

from procedures.cli.plan import app as plan
from procedures.planning.plan_model import PlannedTrajectory
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import unit_of
from sim.cli import app as simulators


@pytest.mark.parametrize(
    ("name", "unit"),
    [("margin_mm", "mm"), ("--speed-mm-s", "mm/s"), ("MM/S", "mm/s"), ("--seed", ""), ("items", "")],
)
def test_a_name_tells_its_unit(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_the_limit_of_an_option_has_the_unit_of_its_name_or_placeholder() -> None:
    by_placeholder = in_this_process(plan, "place", "x", "--ct", "y", "--within", "5")
    assert "expected at least 60 mm." in by_placeholder.stderr
    by_name = in_this_process(simulators, "phantom", "--out", "x", "--thickness-mm", "30")
    assert "expected at most 20 mm." in by_name.stderr


def test_the_limit_of_a_value_in_a_file_has_the_unit_of_its_key() -> None:
    with pytest.raises(ValidationError) as found:
        PlannedTrajectory.model_validate(
            {"id": "T1", "entry_mm": (0.0, 0.0, 2e4), "target_mm": (0.0, 0.0, 0.0), "margin_mm": -1.0}
        )
    entry, margin = describe_mistakes(found.value)
    assert "less than or equal to 10000 mm" in entry
    assert "greater than 0 mm" in margin
