"""Every checklist line has a case or names where it is shown; every case has its line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from conformance import robot, stereo, tracker
from conformance.case import DESTRUCTIVE, Suite
from conformance.gige.protocol import GIGE_CHECKLIST
from conformance.gige.protocol import PROTOCOL as GIGE
from conformance.kuka.protocol import KUKA_CHECKLIST
from conformance.kuka.protocol import PROTOCOL as KUKA
from conformance.polaris.protocol import POLARIS_CHECKLIST
from conformance.polaris.protocol import PROTOCOL as POLARIS
from conformance.protocol import Checklist, compose_suite

ROOT = Path(__file__).parents[3]
TRACKER = compose_suite(tracker.SUITE, POLARIS)
ROBOT = compose_suite(robot.SUITE, KUKA)
STEREO = compose_suite(stereo.SUITE, GIGE)
CHECKLISTS = [
    pytest.param(POLARIS_CHECKLIST, TRACKER, 50, id="polaris"),
    pytest.param(KUKA_CHECKLIST, ROBOT, 44, id="kuka"),
    pytest.param(GIGE_CHECKLIST, STEREO, 42, id="gige"),
]
of_each_checklist = pytest.mark.parametrize(("checklist", "suite", "lines"), CHECKLISTS)


def numbers_of(suite: Suite) -> list[str]:
    return [case.number for case in suite.cases]


@of_each_checklist
def test_every_line_has_a_case_or_names_where_it_is_shown(
    checklist: Checklist, suite: Suite, lines: int
) -> None:
    found = checklist.cases_by_line(numbers_of(suite))
    assert sorted(checklist.lines) == list(range(1, lines + 1))
    assert {line for line, cases in found.items() if not cases} == set(checklist.elsewhere)
    assert set(checklist.remarks) | set(checklist.also) <= set(checklist.lines)


@of_each_checklist
def test_every_case_of_the_protocol_belongs_to_a_line(checklist: Checklist, suite: Suite, lines: int) -> None:
    for number in numbers_of(suite):
        if number[0] in checklist.letters:
            assert checklist.line_of(number) in checklist.lines, number
        else:
            assert re.fullmatch(r"[TRS]\d\d", number), number


@of_each_checklist
def test_additional_cases_of_a_line_exist(checklist: Checklist, suite: Suite, lines: int) -> None:
    assert {number for also in checklist.also.values() for number in also} <= set(numbers_of(suite))


@of_each_checklist
def test_the_test_and_benchmark_paths_named_exist(checklist: Checklist, suite: Suite, lines: int) -> None:
    for text in (*checklist.elsewhere.values(), *checklist.remarks.values()):
        for place in re.findall(r"(?:tests|benchmarks)/[\w/.]+\w", text):
            assert (ROOT / place).exists(), place


@pytest.mark.parametrize(
    ("checklist", "suite", "of_device"),
    [(POLARIS_CHECKLIST, TRACKER, "P"), (KUKA_CHECKLIST, ROBOT, "K")],
    ids=["polaris", "kuka"],
)
def test_a_case_about_device_or_driver_belongs_to_a_line_about_it(
    checklist: Checklist, suite: Suite, of_device: str
) -> None:
    for number in numbers_of(suite):
        if (line := checklist.line_of(number)) is not None:
            assert f"{'S' if number[0] == of_device else 'D'}:" in checklist.lines[line], number


def test_the_tracker_cases_that_reset_the_device_need_permission() -> None:
    resets = {case.number for case in TRACKER.cases if DESTRUCTIVE in case.needs}
    assert resets == {"P01", "P01b", "P09"}
