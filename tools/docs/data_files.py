"""The data files of the reference: TOML, one array of tables each."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
TESTS = ROOT / "tests"

RowT = TypeVar("RowT")


def read_rows(path: Path, key: str, row: type[RowT]) -> list[RowT]:
    """The tables `[[key]]` of a file as rows; raises TypeError for surplus or missing fields."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))[key]
    return [
        row(**{name: tuple(value) if isinstance(value, list) else value for name, value in one.items()})
        for one in entries
    ]
