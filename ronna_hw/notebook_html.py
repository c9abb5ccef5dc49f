"""HTML of results for notebooks: tables with units in their heads, bounded in length."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from itertools import islice
from typing import Any

import numpy as np

MOST_ROWS = 40  # of a table; more are counted
DIGITS = 5  # significant, of a number


def table_html(heads: Sequence[str], rows: Iterable[Sequence[Any]], count: int, caption: str = "") -> str:
    """Return a table of at most `MOST_ROWS` of `count` rows. Numbers are rounded; a vector is one cell."""
    shown = [[format_value(value) for value in row] for row in islice(rows, MOST_ROWS)]
    more = count - len(shown)
    lines = [f"<caption>{escape(caption)}</caption>" if caption else ""]
    lines.append(f"<thead><tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr></thead>")
    lines += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in shown]
    if more > 0:
        lines.append(f'<tr><td colspan="{len(heads)}">and {more} more rows</td></tr>')
    return f"<table>{''.join(lines)}</table>"


def format_value(value: Any) -> str:
    """Format a value for one cell or one line: rounded numbers, an unknown one empty."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.{DIGITS}g}"
    if isinstance(value, np.ndarray):
        return ", ".join(format_value(one) for one in value.ravel().tolist())
    return str(value)
