"""Every line of the checklist of RSI and EKI has a case, or a reason and a place where it is shown."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ronna_hw.conformance.kuka_checklist import ELSEWHERE, LINES, REMARKS, cases_by_line
from ronna_hw.conformance.robot import SUITE

ROOT = Path(__file__).parents[3]
CASES = cases_by_line([case.number for case in SUITE.cases])


@pytest.mark.parametrize("line", LINES)
def test_a_line_has_a_case_or_a_place_elsewhere(line: int) -> None:
    assert bool(CASES[line]) != (line in ELSEWHERE)


def test_every_case_of_the_checklist_belongs_to_a_line() -> None:
    listed = {number for numbers in CASES.values() for number in numbers}
    assert listed == {case.number for case in SUITE.cases if case.number[0] in "KL"}


def test_the_places_named_exist() -> None:
    for text in (*ELSEWHERE.values(), *REMARKS.values()):
        for place in re.findall(r"tests/[\w/.]+\w", text):
            assert (ROOT / place).exists(), place
