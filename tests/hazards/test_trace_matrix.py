"""The hazard table is consistent: every covered hazard has a test, and the page matches the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import hazard_matrix
import pytest
from hazard_ledger import OPTION

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
GIVEN = 38  # rows of the list that the project began with


@pytest.fixture(scope="module")
def bound() -> list[hazard_matrix.BoundTest]:
    """All tests with a hazard mark."""
    return hazard_matrix.find_bound_tests()


def test_the_hazards_are_numbered_without_gaps() -> None:
    numbers = [hazard.number for hazard in hazard_matrix.read_hazards()]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= GIVEN


def test_every_hazard_has_a_test_that_make_test_all_runs(bound: list[hazard_matrix.BoundTest]) -> None:
    run = {test.number for test in bound if test.runs_in != "make soak"}
    assert {hazard.number for hazard in hazard_matrix.read_hazards()} - run == set()


def test_no_hazard_is_controlled_in_part() -> None:
    assert [one.number for one in hazard_matrix.read_hazards() if one.status != "covered"] == []


SAMPLE = """
import pytest
from hazard_matrix import read_hazards

NUMBERS = [hazard.number for hazard in read_hazards()]
MARKS = {7: [pytest.mark.skip], 11: [pytest.mark.soak], 13: [pytest.mark.xfail]}

@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.hazard(n), *MARKS.get(n, [])]) for n in NUMBERS]
)
def test_sample(number):
    assert number != 13
"""


@pytest.mark.slow
def test_a_hazard_without_a_passing_test_fails_the_run(tmp_path: Path) -> None:
    sample = tmp_path / "test_sample.py"
    sample.write_text(SAMPLE)
    program = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "hazard_ledger")
    line = (*program, "-c", str(PROJECT), "--rootdir", str(tmp_path), "-m", "not soak", str(sample))
    folders = ("tests/support/command", "tools/docs")
    paths = os.pathsep.join(str(PROJECT.parent / folder) for folder in folders)
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run((*line, OPTION), env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout + done.stderr
    assert "hazards without a passing test" in done.stdout
    assert "7, 11, 13" in done.stdout.splitlines()


def test_every_bound_test_names_a_known_hazard(bound: list[hazard_matrix.BoundTest]) -> None:
    assert {test.number for test in bound} - {
        hazard.number for hazard in hazard_matrix.read_hazards()
    } == set()


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
    found = {(test.number, test.statement, test.runs_in) for test in hazard_matrix.find_bound_tests(tmp_path)}
    assert found == {
        (1, "on a function", "make test-all"),
        (2, "on a function", "make test-all"),
        (1, "in a class", "make test"),
        (3, "in a class", "make test"),
        (1, "on a parameter", "make test"),
        (4, "on a parameter", "make test"),
    }


@pytest.mark.parametrize(
    "text", ["status = 'nearly'", "status = 'covered'\nremains = 'something'", "status = 'partly'"]
)
def test_a_contradictory_table_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "hazards.toml"
    path.write_text(f"[[hazard]]\nnumber = 1\nhazard = 'a'\ncontrol = 'b'\n{text}\n")
    with pytest.raises(ValueError, match=r"nearly|remains"):
        hazard_matrix.read_hazards(path)
