"""The hazard table holds: what is called covered has a test, and the page says what the tests say."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import hazard_matrix
import pytest
from hazard_ledger import HazardLedger

GIVEN = 38  # rows of the list that the project began with


def test_the_hazards_are_numbered_without_gaps() -> None:
    numbers = [hazard.number for hazard in hazard_matrix.read_hazards()]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= GIVEN


def test_every_hazard_with_a_control_has_a_test_that_make_test_all_runs() -> None:
    run = {test.number for test in hazard_matrix.bound_tests() if test.runs_in != "make soak"}
    demanded = {h.number for h in hazard_matrix.read_hazards() if h.status != hazard_matrix.Status.PLANNED}
    assert demanded - run == set()


def test_a_hazard_without_a_passing_test_fails_the_run() -> None:
    ledger = HazardLedger(frozenset({1, 2, 3}))
    for outcome, number in (("passed", 1), ("skipped", 2), ("failed", 3)):
        report = SimpleNamespace(
            when="call", passed=outcome == "passed", user_properties=[("hazard", number)]
        )
        ledger.pytest_runtest_logreport(report)  # type: ignore[arg-type]
    session = SimpleNamespace(exitstatus=pytest.ExitCode.OK)
    ledger.pytest_sessionfinish(session)  # type: ignore[arg-type]
    assert ledger.without_a_passing_test == [2, 3]
    assert session.exitstatus == pytest.ExitCode.TESTS_FAILED


def test_every_hazard_with_a_control_has_a_test_and_every_bound_test_names_a_hazard() -> None:
    bound = {test.number for test in hazard_matrix.bound_tests()}
    hazards = hazard_matrix.read_hazards()
    assert {h.number for h in hazards if h.status != hazard_matrix.Status.PLANNED} - bound == set()
    assert bound - {hazard.number for hazard in hazards} == set()


def test_marks_are_found_on_functions_classes_modules_and_parameters(tmp_path: Path) -> None:
    (tmp_path / "test_sample.py").write_text(
        "import pytest\n"
        "pytestmark = [pytest.mark.hazard(1)]\n"
        "@pytest.mark.hazard(2)\n@pytest.mark.slow\ndef test_on_a_function(): ...\n"
        "@pytest.mark.hazard(3)\nclass TestGroup:\n    def test_in_a_class(self): ...\n"
        "@pytest.mark.parametrize('x', [pytest.param(1, marks=pytest.mark.hazard(4)), 2])\n"
        "def test_on_a_parameter(x): ...\n"
        "@pytest.mark.hazard(5)\n@pytest.mark.xfail\ndef test_that_shows_a_gap(): ...\n"
        "@pytest.mark.hazard(6)\ndef helper(): ...\n"
    )
    found = {(test.number, test.statement, test.runs_in) for test in hazard_matrix.bound_tests(tmp_path)}
    assert found == {
        (1, "on a function", "make test-all"),
        (2, "on a function", "make test-all"),
        (1, "in a class", "make test"),
        (3, "in a class", "make test"),
        (1, "on a parameter", "make test"),
        (4, "on a parameter", "make test"),
    }


@pytest.mark.parametrize(
    "text",
    [
        "status = 'nearly'",
        "status = 'covered'\nremains = 'something'",
        "status = 'partly'",
    ],
)
def test_a_table_that_contradicts_itself_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "hazards.toml"
    path.write_text(f"[[hazard]]\nnumber = 1\nhazard = 'a'\ncontrol = 'b'\n{text}\n")
    with pytest.raises(ValueError, match=r"nearly|remains"):
        hazard_matrix.read_hazards(path)
