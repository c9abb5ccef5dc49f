"""The checklist is complete: every line has a case, or says where else it is shown."""

import re

from ronna_hw.conformance.polaris_checklist import ALSO, ELSEWHERE, LINES, REMARKS, cases_by_line, line_of
from ronna_hw.conformance.tracker import SUITE


def test_every_line_has_a_case_or_says_where_it_is_shown() -> None:
    found = cases_by_line(SUITE.cases)
    assert sorted(LINES) == list(range(1, 51))
    assert {line for line, cases in found.items() if not cases} == set(ELSEWHERE)
    assert set(REMARKS) | set(ALSO) <= set(LINES)


def test_cases_about_the_unit_and_its_driver_stand_under_lines_about_them() -> None:
    for case in SUITE.cases:
        line = line_of(case)
        if line is not None:
            assert LINES[line][0] == {"P": "S", "D": "D"}[case.number[0]], case.number


def test_every_case_is_about_a_line_or_about_any_tracker() -> None:
    for case in SUITE.cases:
        assert re.fullmatch(r"T\d\d|[PD]\d\d[a-z]?", case.number), case.number
        assert (line_of(case) is None) == case.number.startswith("T")


def test_what_is_also_looked_at_exists() -> None:
    numbers = {case.number for case in SUITE.cases}
    assert {number for also in ALSO.values() for number in also} <= numbers


def test_what_resets_the_unit_is_not_run_unless_it_is_allowed() -> None:
    resets = {case.number for case in SUITE.cases if "destructive" in case.needs}
    assert resets == {"P01", "P01b", "P09"}
