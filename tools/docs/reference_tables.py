"""Reference tables built from data files: disturbances, open questions, scanner faults, checklists."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, TypeVar

from conformance.case import Suite
from conformance.protocol import compose_suite, load_protocol
from sim.kuka.controller_parameters import ControllerParameters
from sim.named_parameters import rows

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
TESTS = ROOT / "tests"

RowT = TypeVar("RowT")


def read_rows(path: Path, key: str, row: type[RowT]) -> list[RowT]:
    """Read a file's `[[key]]` tables as rows; raises TypeError for unknown or missing fields."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))[key]
    return [
        row(**{name: tuple(value) if isinstance(value, list) else value for name, value in one.items()})
        for one in entries
    ]


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(map(str, cells))} |\n" for cells in lines)


_TEST = re.compile(r"^ *def (test_\w+)", re.MULTILINE)


@dataclass(frozen=True)
class Disturbance:
    """A row of the disturbance table. `faults` are fault kinds, `tests` are test function names."""

    disturbance: str
    arm: str
    message: str
    within: str
    tests: tuple[str, ...]
    codes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def read_disturbances() -> list[Disturbance]:
    return read_rows(REFERENCE / "link-disturbances.toml", "disturbance", Disturbance)


def files_of_tests() -> dict[str, tuple[Path, ...]]:
    """Map each test function name to the files that define it."""
    found: dict[str, tuple[Path, ...]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        for name in _TEST.findall(path.read_text(encoding="utf-8")):
            found[name] = (*found.get(name, ()), path)
    return found


def disturbances() -> str:
    """Tabulate the disturbances; raises KeyError if a listed test does not exist."""
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
                "<br>".join(_format_link(name, files[name][0]) for name in one.tests),
            )
            for one in read_disturbances()
        ],
    )


def _format_link(name: str, path: Path) -> str:
    words = name.removeprefix("test_").replace("_", " ")
    return f"[{words}](../../{path.relative_to(ROOT).as_posix()})"


@dataclass(frozen=True)
class Question:
    """An open question, with the settings that answer it."""

    subject: str
    question: str
    parameters: tuple[str, ...] = ()
    context: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    otherwise: str = ""

    @property
    def answers(self) -> Iterator[str]:
        """The question's settings, formatted for the page."""
        yield from (f"`{name}`" for name in self.parameters)
        yield from (f"`{name}` of the context" for name in self.context)
        yield from (f"`arm.{name}` of the scene" for name in self.scene)
        yield from (f"`{name}`" for name in self.options)
        if self.otherwise:
            yield self.otherwise


def read_questions() -> list[Question]:
    return read_rows(REFERENCE / "robot-open-questions.toml", "question", Question)


def robot_parameters() -> str:
    """Compose the table of open questions, followed by the table of all parameters."""
    questions = [(one.subject, one.question, ", ".join(one.answers)) for one in read_questions()]
    return (
        table(("", "open question", "set by"), questions)
        + "\n## Parameters\n\n"
        + parameter_table(rows(ControllerParameters))
    )


def parameter_table(rows: Iterable[tuple[str, object, str]]) -> str:
    return table(
        ("parameter", "best estimate", "meaning"),
        [(f"`{name}`", value, meaning) for name, value, meaning in rows],
    )


def vendor_tests() -> str:
    """Tabulate the vendor's own tests of its client library, and name those that do not pass."""
    data = tomllib.loads((REFERENCE / "ur-client-library.toml").read_text(encoding="utf-8"))
    rows, others = [], []
    for suite in data["suite"]:
        results: dict[str, str] = suite["tests"]
        passing = sum(result == "passes" for result in results.values())
        options = ", ".join(filter(None, (" ".join(suite["options"]), suite.get("faults"))))
        rows.append((suite["name"], f"`{options}`" if options else "", passing, len(results) - passing))
        others += [(f"`{name}`", result) for name, result in results.items() if result != "passes"]
    return (
        f"{data['library']} {data['version']}, commit `{data['commit'][:12]}`, headless: {data['how']}\n\n"
        + table(("tests", "simulator", "pass", "others"), rows)
        + "\n"
        + table(("other test", ""), others)
    )


def scanner_faults() -> str:
    """Describe the limits measured without faults, then tabulate the faults."""
    data = tomllib.loads((REFERENCE / "scanner-faults.toml").read_text(encoding="utf-8"))
    quiet, rows = data["quiet"], data["fault"]
    without = (
        f"In {quiet['volumes']} scans of every family, protocol and kernel, half of them with overlap, "
        f"but without motion, tilt and error of the table, the largest values are "
        f"{quiet['across_mm']:g} mm sideways, "
        f"{quiet['share']:.0%} explained by a shift, and a change that correlates by "
        f"-{quiet['backwards']:g} with those around it (a warning needs 0.4 mm and 10 %, or -0.7), "
        f"{quiet['strain_percent']:g} % of stretch or shear, and {quiet['chi_square']:g} for its chi-square "
        f"(refused beyond 20.5). "
        f"Told: {quiet['told'] or 'nothing'}."
    )
    return f"{without}\n\n" + table(
        (
            "fault",
            "option",
            "error, µm (largest)",
            "after a rigid fit, µm",
            "chi² / 3n",
            "missed / false",
            "told",
        ),
        [
            (
                row["fault"],
                f"`{row['options']}`" if row["options"] else "",
                f"{row['error_um']:g} ({row['largest_um']:g})" if "error_um" in row else "",
                f"{row['fitted_um']:g}" if row.get("fitted_um", nan) > 0.0 else "",
                f"{row['chi2']:g}" if "chi2" in row else "",
                _format_outcome(row),
                row["told"],
            )
            for row in rows
        ],
    )


def _format_outcome(row: dict[str, Any]) -> str:
    if "missed" not in row:
        return "refused"
    some = f"; {row['refused']} of {row['volumes']} scans refused" if row["refused"] else ""
    return f"{row['missed']} / {row['false']} of {row['markers']}{some}"


def checklist(generic: Suite, wire_protocol: str) -> str:
    """Compose a protocol's checklist, with the test cases that cover each line."""
    protocol = load_protocol(wire_protocol)
    cases, lines = compose_suite(generic, protocol).cases, protocol.checklist
    assert lines is not None, f"{wire_protocol} has a checklist"
    return table(
        ("line", "requirement", "cases", ""),
        [
            (line, lines.lines[line], ", ".join(numbers) or "-", lines.remark(line))
            for line, numbers in lines.cases_by_line(case.number for case in cases).items()
        ],
    )
