"""Rows of the tables of `docs/reference/thesis.md`: places of the thesis, and what goes beyond it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "thesis.md"
COLUMNS = ["thesis", "what", "here", "module", "command", "reached"]
BEYOND = ["beside", "what", "module", "command", "reached"]  # no places of the thesis, not counted
CODE = re.compile(r"`([^`]+)`")


def table_rows(columns: Sequence[str] = COLUMNS) -> list[dict[str, str]]:
    """Return every row below a header with these columns, by column."""
    rows = []
    header: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] if line.startswith("|") else []
        if not cells:
            header = []
        elif not header:
            header = cells
        elif header == list(columns) and not set("".join(cells)) <= set("-"):
            rows.append(dict(zip(columns, cells, strict=True)))
    return rows


def commands() -> list[str]:
    """Return every command that a row names, once."""
    rows = table_rows() + table_rows(BEYOND)
    return list(dict.fromkeys(one for row in rows for one in CODE.findall(row["command"])))
