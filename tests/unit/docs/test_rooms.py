"""`docs/explanation/rooms.md` lists every subpackage, and what the console may import."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/explanation/rooms.md").read_text(encoding="utf-8")


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
