"""HTML of results for notebooks: tables with units in their heads, bounded in length."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_ROWS = 40  # of a table; more are counted
WIDEST_PX = 480  # of a picture; two fit beside each other
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


def picture_html(name: str, pixels: NDArray[Any]) -> str:
    """Return a grey picture as an image, no wider than `WIDEST_PX`, from black to its brightest pixel."""
    import cv2  # for notebooks alone: importing it takes longer than a table

    step = -(-pixels.shape[1] // WIDEST_PX)
    small = pixels[::step, ::step]
    grey = (small * (255.0 / max(int(small.max(initial=1)), 1))).astype(np.uint8)
    _, content = cv2.imencode(".png", grey)
    source = f"data:image/png;base64,{b64encode(content.tobytes()).decode()}"
    return f'<img alt="{escape(name)}" title="{escape(name)}" src="{source}">'


def format_value(value: Any) -> str:
    """Format a value for one cell or one line: rounded numbers, an unknown one empty."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.{DIGITS}g}"
    if isinstance(value, np.ndarray):
        return ", ".join(format_value(one) for one in value.ravel().tolist())
    return str(value)
