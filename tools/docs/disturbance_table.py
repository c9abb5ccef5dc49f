"""Disturbances of the robot's links, the specified reaction to each, and the tests that verify it.

The specification is a data file. That every test named in it exists and covers the error codes is checked in
the source of the tests.
"""

from __future__ import annotations

import ast
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DISTURBANCE_FILE = ROOT / "docs" / "reference" / "link-disturbances.toml"
TESTS = ROOT / "tests"
PAGE = "link-disturbances.md"


@dataclass(frozen=True)
class Disturbance:
    """One line of the table; `faults` are names of fault kinds, `tests` names of test functions."""

    disturbance: str
    arm: str
    message: str
    within: str
    tests: tuple[str, ...]
    codes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def read_disturbances(path: Path = DISTURBANCE_FILE) -> tuple[Disturbance, ...]:
    """The disturbances of the data file; raises TypeError for surplus or missing keys."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["disturbance"]
    return tuple(
        Disturbance(**{key: tuple(value) if isinstance(value, list) else value for key, value in one.items()})
        for one in entries
    )


def files_of_tests(tests: Path = TESTS) -> dict[str, tuple[Path, ...]]:
    """The files that define a test function, by its name."""
    found: dict[str, tuple[Path, ...]] = {}
    for path in sorted(tests.rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                found[node.name] = (*found.get(node.name, ()), path)
    return found


def disturbance_page() -> str:
    """The page in Markdown. Raises KeyError for a test that does not exist."""
    files = files_of_tests()
    lines = [
        "# Disturbances of the robot's links\n",
        "Generated from `link-disturbances.toml` and the tests. Each row specifies what the arm does, what",
        "the operator reads, and how soon; and the tests that verify it. FAULT is latched: only `recover`",
        "leaves it, which acknowledges, re-reads the controller and moves nothing. The last cycles are",
        "attached to the error.\n",
        "| disturbance | the arm | message | within | injected by `ronna-sim fault` | tests |",
        "|---|---|---|---|---|---|",
    ]
    for one in read_disturbances():
        message = f"{', '.join(one.codes)}: {one.message}" if one.codes else one.message
        faults = ", ".join(fault.replace("_", " ") for fault in one.faults)
        tests = "<br>".join(_link(name, files[name][0]) for name in one.tests)
        lines.append(f"| {one.disturbance} | {one.arm} | {message} | {one.within} | {faults} | {tests} |")
    return "\n".join(lines) + "\n"


def _link(name: str, path: Path) -> str:
    words = name.removeprefix("test_").replace("_", " ")
    return f"[{words}](../../{path.relative_to(ROOT).as_posix()})"
