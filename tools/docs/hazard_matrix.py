"""Trace matrix of hazards, their controls, and the tests that would detect the loss of a control.

Tests are parsed, not run: a `hazard` mark counts if its test is expected to pass.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from reference_tables import REFERENCE, TESTS, read_rows, table

WHERE_IT_RUNS = {"soak": "make soak", "slow": "make test-all"}  # by mark; without one: make test
_MARK = re.compile(r"pytest\.mark\.(\w+)(?:\((\d+)\))?")


class Status(StrEnum):
    """Status of a hazard's control."""

    COVERED = "covered"
    PARTLY = "partly"


@dataclass(frozen=True)
class Hazard:
    """A row of the hazard table. `remains` is empty only if the hazard is covered."""

    number: int
    hazard: str
    control: str
    status: str
    remains: str = ""

    def __post_init__(self) -> None:
        if (Status(self.status) is Status.COVERED) == bool(self.remains):
            raise ValueError(f"hazard {self.number}: `remains` is given unless it is covered")


@dataclass(frozen=True)
class BoundTest:
    """A test with a hazard mark. `path` is relative to the repository."""

    number: int
    path: str
    name: str
    runs_in: str

    @property
    def statement(self) -> str:
        return self.name.removeprefix("test_").replace("_", " ")


def read_hazards(path: Path = REFERENCE / "hazards.toml") -> list[Hazard]:
    """Read the hazards, sorted by number; raises ValueError for a wrong status or `remains` text."""
    return sorted(read_rows(path, "hazard", Hazard), key=lambda hazard: hazard.number)


def find_bound_tests(tests: Path = TESTS) -> list[BoundTest]:
    """Find all tests with a hazard mark, sorted by hazard, file and name."""
    found: list[BoundTest] = []
    for path in sorted(tests.rglob("test_*.py")):
        source = path.read_text(encoding="utf-8")
        if "mark.hazard" not in source:
            continue
        tree = ast.parse(source, str(path))
        marks = [
            node.value
            for node in tree.body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
        ]
        found += _find_tests(tree.body, marks, path.relative_to(tests.parent).as_posix())
    return sorted(found, key=lambda test: (test.number, test.path, test.name))


def hazard_table() -> str:
    """Compose the matrix, preceded by the number of hazards in each status."""
    hazards, tests = read_hazards(), find_bound_tests()
    statuses = [hazard.status for hazard in hazards]
    counts = ", ".join(f"{statuses.count(status)} {status}" for status in Status)
    rows = []
    for hazard in hazards:
        bound = [
            f"[{test.statement}](../../{test.path}) ({test.runs_in})"
            for test in tests
            if test.number == hazard.number
        ]
        status = ": ".join(filter(None, (hazard.status, hazard.remains)))
        rows.append((hazard.number, hazard.hazard, hazard.control, status, "<br>".join(bound) or "–"))
    headings = ("#", "hazard", "control", "status", "tests")
    return f"{len(hazards)} hazards: {counts}.\n\n{table(headings, rows)}"


def _find_tests(
    body: Sequence[ast.stmt], inherited: Sequence[ast.expr], file_path: str
) -> Iterator[BoundTest]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from _find_tests(node.body, (*inherited, *node.decorator_list), file_path)
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            marks = _MARK.findall(" ".join(map(ast.unparse, (*inherited, *node.decorator_list))))
            names = {name for name, _ in marks}
            if names & {"xfail", "skip"}:
                continue  # shows a gap, not a control
            runs_in = next((target for mark, target in WHERE_IT_RUNS.items() if mark in names), "make test")
            for number in sorted({int(number) for name, number in marks if name == "hazard"}):
                yield BoundTest(number, file_path, node.name, runs_in)
