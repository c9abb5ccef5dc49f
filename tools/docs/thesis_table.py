"""Rows of the tables of `docs/reference/thesis.md`."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "thesis.md"
COLUMNS = ["thesis", "what", "here", "module", "command", "reached"]
CODE = re.compile(r"`([^`]+)`")


def table_rows() -> list[dict[str, str]]:
    """Return every row below a header with these columns, by column."""
    rows = []
    header: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] if line.startswith("|") else []
        if not cells:
            header = []
        elif not header:
            header = cells
        elif header == COLUMNS and not set("".join(cells)) <= set("-"):
            rows.append(dict(zip(COLUMNS, cells, strict=True)))
    return rows


def commands() -> list[str]:
    """Return every command that a row names, once."""
    return list(dict.fromkeys(one for row in table_rows() for one in CODE.findall(row["command"])))
