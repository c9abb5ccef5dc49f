"""Table cells labelled with their headings, so that a phone shows each row as a block and nothing scrolls."""

from __future__ import annotations

import re

MOST_SIDE_BY_SIDE = 3  # columns that fit beside each other on a phone
FITS = 'class="fits"'  # short numbers only: stays a table of more columns
TABLE = re.compile(r"<table(?P<attributes>[^>]*)>(?P<body>.*?)</table>", re.DOTALL)
ROW = re.compile(r"<tr\b.*?</tr>", re.DOTALL)
HEADING = re.compile(r"<th>(.*?)</th>", re.DOTALL)
CELL = re.compile(r"<td\b")


def label_cells(page: str) -> str:
    """Mark the wide tables of a page and give each of their cells its heading as `data-label`.

    For pages of this package's template alone: their cells are escaped, so that no tag in them is a text's.
    """
    return TABLE.sub(_label_table, page)


def _label_table(table: re.Match[str]) -> str:
    attributes, body = table["attributes"], table["body"]
    headings = [
        " ".join(one.replace('"', "&quot;").split()) for one in HEADING.findall(body.partition("</thead>")[0])
    ]
    if FITS in attributes or len(headings) <= MOST_SIDE_BY_SIDE:
        return table[0]

    def labelled(row: re.Match[str]) -> str:
        left = iter(headings)
        return CELL.sub(lambda _cell: f'<td data-label="{next(left, "")}"', row[0])

    kinds = re.findall(r'class="([^"]*)"', attributes)
    return f'<table class="{" ".join([*kinds, "stacked"])}">{ROW.sub(labelled, body)}</table>'
