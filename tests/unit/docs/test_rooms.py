"""`docs/explanation/rooms.md` lists every subpackage, and its safety limits are where it says."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/explanation/rooms.md").read_text(encoding="utf-8")
LISTED = re.findall(r"`([\w/]+\.py)`: ((?:`\w+`(?:, )?)+)", PAGE.partition("\n## Safety limits\n")[2])
NO_LIMITS = {
    *("BETWEEN_LOOKS_S", "DOUBT_MM"),  # when to look
    *("REPEATING_S", "LARGEST_STEP_S", "HEAD_LEVEL_MM", "HEAD_LEVEL_DEG"),  # beyond them only a finding
    *("ALIKE_MM", "ANOTHER_BALL_MM", "OVER_SPHERE_MM"),  # rounding; of a calibration; of a rehearsal
}


@pytest.mark.parametrize(
    "package", ["ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console"]
)
def test_every_subpackage_is_listed_once(package: str) -> None:
    section = PAGE.partition(f"\n## `{package}`\n")[2].partition("\n## ")[0]
    listed = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
    there = sorted(one.parent.name for one in (ROOT / package).glob("*/__init__.py"))
    assert sorted(listed) == there


def test_what_the_console_may_import_is_all_that_its_contract_does_not_forbid() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (console,) = (one for one in contracts if one.get("source_modules") == ["console"])
    named = PAGE.partition("| `console` |")[2].partition("of `procedures` only ")[2].partition("\n")[0]
    allowed = {f"procedures.{room}" for room in re.findall(r"`(\w+)`", named)}
    rooms = {f"procedures.{one.parent.name}" for one in (ROOT / "procedures").glob("*/__init__.py")}
    assert allowed == rooms - set(console["forbidden_modules"])


def test_every_safety_limit_is_defined_in_the_module_named() -> None:
    assert len(LISTED) > 15
    missing = [
        f"{path}: {name}"
        for path, names in LISTED
        for name in re.findall(r"\w+", names)
        if not re.search(rf"^\s*(?:\w+, )*{name}\b[^\n]*=", (ROOT / path).read_text("utf-8"), re.MULTILINE)
    ]
    assert missing == []


@pytest.mark.parametrize("room", ["guards", "steps", "workcell"])
def test_every_length_angle_or_time_of_a_case_that_something_is_compared_with_is_listed(room: str) -> None:
    listed = {(path, name) for path, names in LISTED for name in re.findall(r"\w+", names)}
    found = set()
    for module in (ROOT / "procedures" / room).rglob("*.py"):
        nodes = list(ast.walk(ast.parse(module.read_text(encoding="utf-8"))))
        parts = [part for node in nodes if isinstance(node, ast.Compare) for part in ast.walk(node)]
        compared = {one.id for one in parts if isinstance(one, ast.Name)}
        own = {one.id for one in nodes if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
        limits = {one for one in compared & own if re.fullmatch(r"[A-Z_]+_(MM|RAD|DEG|S)", one)}
        if "calibration" not in module.parts:
            found |= {(module.relative_to(ROOT).as_posix(), name) for name in limits - NO_LIMITS}
    assert found
    assert sorted(found - listed) == []
