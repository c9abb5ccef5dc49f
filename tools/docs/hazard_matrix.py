"""The trace matrix: each hazard with its control, and the tests that would detect the loss of the control.

Tests are parsed, not run: what counts is a `hazard` mark on a test that is expected to pass.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HAZARD_FILE = ROOT / "docs" / "reference" / "hazards.toml"
TESTS = ROOT / "tests"
PAGE = "hazards.md"
MARK = "hazard"
WHERE_IT_RUNS = {"soak": "make soak", "slow": "make test-all"}  # by mark; without one: make test


class Status(StrEnum):
    """How far a hazard is under control."""

    COVERED = "covered"
    PARTLY = "partly"
    PLANNED = "planned"


@dataclass(frozen=True)
class Hazard:
    """One line of the table; `remains` is empty only when the hazard is covered."""

    number: int
    hazard: str
    control: str
    status: Status
    remains: str = ""


@dataclass(frozen=True)
class BoundTest:
    """A test with a hazard mark; `path` is relative to the repository."""

    number: int
    path: str
    name: str
    runs_in: str

    @property
    def statement(self) -> str:
        """The test's name as a sentence."""
        return self.name.removeprefix("test_").replace("_", " ")


def read_hazards(path: Path = HAZARD_FILE) -> tuple[Hazard, ...]:
    """The hazards of the data file, by number; raises ValueError for a wrong status or missing text."""
    hazards = []
    for entry in tomllib.loads(path.read_text(encoding="utf-8"))["hazard"]:
        hazard = Hazard(**{**entry, "status": Status(entry["status"])})
        if (hazard.status is Status.COVERED) == bool(hazard.remains):
            raise ValueError(
                f"hazard {hazard.number}: `remains` belongs to what is not covered, and only there"
            )
        hazards.append(hazard)
    return tuple(sorted(hazards, key=lambda hazard: hazard.number))


def bound_tests(tests: Path = TESTS) -> tuple[BoundTest, ...]:
    """Every test with a hazard mark, in order of hazard, file and name."""
    found: list[BoundTest] = []
    for path in sorted(tests.rglob("test_*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
        where = path.relative_to(tests.parent).as_posix()
        found += _tests_of(tree.body, _module_marks(tree), where)
    return tuple(sorted(found, key=lambda test: (test.number, test.path, test.name)))


def hazard_page() -> str:
    """The page in Markdown."""
    hazards, tests = read_hazards(), bound_tests()
    counts = {status: sum(hazard.status is status for hazard in hazards) for status in Status}
    lines = [
        "# Hazards, their controls and tests\n",
        "Generated from `hazards.toml` and the marks of the tests. No certification is claimed.\n",
        f"{len(hazards)} hazards: " + ", ".join(f"{counts[status]} {status}" for status in Status) + ".\n",
        "| # | hazard | control | status | tests |",
        "|---|---|---|---|---|",
    ]
    for hazard in hazards:
        bound = [test for test in tests if test.number == hazard.number]
        status = f"{hazard.status}: {hazard.remains}" if hazard.remains else str(hazard.status)
        lines.append(
            f"| {hazard.number} | {hazard.hazard} | {hazard.control} | {status} "
            f"| {'<br>'.join(_link(test) for test in bound) or '–'} |"
        )
    return "\n".join(lines) + "\n"


def _link(test: BoundTest) -> str:
    return f"[{test.statement}](../../{test.path}) ({test.runs_in})"


Marks = Sequence[ast.expr]


def _tests_of(body: Sequence[ast.stmt], inherited: Marks, where: str) -> Iterator[BoundTest]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from _tests_of(node.body, (*inherited, *node.decorator_list), where)
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            marks = list(_marks((*inherited, *node.decorator_list)))
            names = {name for name, _ in marks}
            if names & {"xfail", "skip"}:
                continue  # shows a gap, not a control
            runs_in = next((target for mark, target in WHERE_IT_RUNS.items() if mark in names), "make test")
            numbers = {number for name, arguments in marks if name == MARK for number in arguments}
            for number in sorted(numbers):
                yield BoundTest(number, where, node.name, runs_in)


def _module_marks(tree: ast.Module) -> list[ast.expr]:
    return [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and any(isinstance(target, ast.Name) and target.id == "pytestmark" for target in node.targets)
    ]


def _marks(expressions: Marks) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Name and whole-number arguments of every `pytest.mark.NAME`, also of those inside parameters."""
    for expression in expressions:
        called = {id(node.func): node for node in ast.walk(expression) if isinstance(node, ast.Call)}
        for node in ast.walk(expression):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pytest.mark":
                call = called.get(id(node))
                arguments = call.args if call else []
                yield (
                    node.attr,
                    tuple(
                        argument.value
                        for argument in arguments
                        if isinstance(argument, ast.Constant) and isinstance(argument.value, int)
                    ),
                )
