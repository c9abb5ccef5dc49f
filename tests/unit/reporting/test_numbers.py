"""A number of the report is its value rounded to the stated decimals, whatever the value."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_figures import NOTHING, rounded

from procedures.reporting import numbers

VALUES = st.none() | st.floats(-1e12, 1e12)


@pytest.mark.hazard(6)
@given(VALUES)
def test_a_formatted_number_has_every_digit_up_to_its_decimals(value: float | None) -> None:
    assert numbers.millimetres(value) == rounded(value, "0.001")
    assert numbers.tenths(value) == rounded(value, "0.1")
    assert numbers.seconds(value) == rounded(value, "0.01")


def test_a_point_has_each_coordinate_in_full() -> None:
    assert numbers.point((-70.5484, 0.0, 1999.9996)) == "-70.548 0.000 2000.000"
    assert numbers.millimetres(None) == NOTHING
