"""Disturbances of the robot's links, the specified reaction to each, and the tests that verify it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from data_files import REFERENCE, ROOT, TESTS, read_rows
from page_tables import table

_TEST = re.compile(r"^ *def (test_\w+)", re.MULTILINE)


@dataclass(frozen=True)
class Disturbance:
    """A line of the table; `faults` are names of fault kinds, `tests` names of test functions."""

    disturbance: str
    arm: str
    message: str
    within: str
    tests: tuple[str, ...]
    codes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def read_disturbances() -> list[Disturbance]:
    """The disturbances of the data file."""
    return read_rows(REFERENCE / "link-disturbances.toml", "disturbance", Disturbance)


def files_of_tests() -> dict[str, tuple[Path, ...]]:
    """The files that define a test function, by its name."""
    found: dict[str, tuple[Path, ...]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        for name in _TEST.findall(path.read_text(encoding="utf-8")):
            found[name] = (*found.get(name, ()), path)
    return found


def disturbances() -> str:
    """The table. Raises KeyError for a test that does not exist."""
    files = files_of_tests()
    return table(
        ("disturbance", "the arm", "message", "within", "injected by `ronna-sim fault`", "tests"),
        [
            (
                one.disturbance,
                one.arm,
                f"{', '.join(one.codes)}: {one.message}" if one.codes else one.message,
                one.within,
                ", ".join(fault.replace("_", " ") for fault in one.faults),
                "<br>".join(_link(name, files[name][0]) for name in one.tests),
            )
            for one in read_disturbances()
        ],
    )


def _link(name: str, path: Path) -> str:
    words = name.removeprefix("test_").replace("_", " ")
    return f"[{words}](../../{path.relative_to(ROOT).as_posix()})"
