"""Every line of the camera's checklist has a case, and every case a line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ronna_hw.conformance.gige_checklist import LINES, REMARKS, cases_by_line
from ronna_hw.conformance.stereo import SUITE

ROOT = Path(__file__).parents[3]
CASES = cases_by_line([case.number for case in SUITE.cases])


@pytest.mark.parametrize("line", LINES)
def test_a_line_has_a_case(line: int) -> None:
    assert CASES[line]


def test_every_case_of_the_protocol_belongs_to_a_line() -> None:
    listed = {number for numbers in CASES.values() for number in numbers}
    assert listed == {case.number for case in SUITE.cases if case.number[0] == "G"}


def test_no_number_is_given_twice() -> None:
    numbers = [case.number for case in SUITE.cases]
    assert len(numbers) == len(set(numbers))


def test_the_places_named_exist() -> None:
    for text in REMARKS.values():
        for place in re.findall(r"(?:tests|benchmarks)/[\w/.]+\w", text):
            assert (ROOT / place).exists(), place
