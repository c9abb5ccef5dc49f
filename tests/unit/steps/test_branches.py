"""The table of branches is complete: each row is covered by a test and names existing steps."""

import re
from pathlib import Path

import pytest

from procedures.operator.question import Topic
from procedures.steps import branches
from procedures.steps.branch import Branch, Ending
from procedures.steps.branches import BRANCHES
from procedures.steps.catalogue import CLINICAL_STEPS

TESTS = Path(__file__).resolve().parents[2]
ROWS = {name: row for name, row in vars(branches).items() if isinstance(row, Branch)}


def test_every_row_is_covered_by_a_test() -> None:
    reached: set[str] = set()
    for path in TESTS.rglob("test_*.py"):
        reached |= set(re.findall(r'mark\.branch\("(\w+)"\)', path.read_text(encoding="utf-8")))
    assert reached == set(ROWS)


def test_the_table_holds_every_row() -> None:
    assert set(BRANCHES) == set(ROWS.values())


@pytest.mark.parametrize("row", BRANCHES, ids=ROWS)
def test_a_row_names_steps_of_a_case(row: Branch) -> None:
    assert set(row.steps) <= {step.name for step in CLINICAL_STEPS}


@pytest.mark.parametrize("row", BRANCHES, ids=ROWS)
def test_only_a_row_that_asks_has_a_question(row: Branch) -> None:
    assert (row.ending is Ending.ASK) == isinstance(row.topic, Topic) == bool(row.answers)


@pytest.mark.parametrize("row", BRANCHES, ids=ROWS)
def test_silence_never_continues_the_case(row: Branch) -> None:
    assert not row.answers or row.answers[-1] != row.answers[0]
