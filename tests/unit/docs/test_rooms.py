"""`docs/explanation/rooms.md` lists every subpackage, and its safety limits are where it says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/explanation/rooms.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("package", ["ronna_hw", "drivers", "sim", "procedures", "console"])
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
    table = PAGE.partition("\n## Safety limits\n")[2]
    places = re.findall(r"`([\w/]+\.py)`: ((?:`\w+`(?:, )?)+)", table)
    assert len(places) > 15
    missing = [
        f"{path}: {name}"
        for path, names in places
        for name in re.findall(r"\w+", names)
        if not re.search(rf"^\s*(?:\w+, )*{name}\b[^\n]*=", (ROOT / path).read_text("utf-8"), re.MULTILINE)
    ]
    assert missing == []
