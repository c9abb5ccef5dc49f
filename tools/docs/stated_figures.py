"""Figures that the pages state, compared with the kept results that they come from.

`docs/reference/figures/README.md` describes the files that are read here.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path("docs/reference/figures")
EXCEPTIONS = "exceptions.toml"
COVERED_PAGES = ("README.md", "docs/explanation/strategies.md", "docs/reference/thesis.md")
STATISTICS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "median": lambda values: float(np.median(values)),
    "max": max,
    "min": min,
    "rms": lambda values: float(np.sqrt(np.mean(np.square(values)))),
    "count": len,
}

Row = Mapping[str, Any]


class FigureMismatch(ValueError):
    """A stated figure that no kept result gives."""


@dataclass(frozen=True)
class StatedFigure:
    """An entry of a figures file: the words on a page, and where their values are kept."""

    page: str
    states: str
    kept: str
    values: tuple[str, ...]
    format: str
    command: str


@dataclass(frozen=True)
class UnkeptFigure:
    """Words of a page that need no kept result, or have none yet, with the reason."""

    page: str
    states: str
    reason: str


def read_figures(root: Path = ROOT) -> list[StatedFigure]:
    """Read the entries of all topics."""
    return [
        StatedFigure(**{**entry, "values": tuple(entry["values"])})
        for path in sorted((root / FOLDER).glob("*.toml"))
        if path.name != EXCEPTIONS
        for entry in tomllib.loads(path.read_text(encoding="utf-8")).get("figure", ())
    ]


def read_unkept(kind: str, root: Path = ROOT) -> list[UnkeptFigure]:
    """Read the entries of a kind, `exception` or `pending`."""
    entries = tomllib.loads((root / FOLDER / EXCEPTIONS).read_text(encoding="utf-8"))
    return [UnkeptFigure(**entry) for entry in entries.get(kind, ())]


def compare(figure: StatedFigure, root: Path = ROOT) -> None:
    """Raise FigureMismatch unless the page states these words once and the kept values give them."""
    where = f"{figure.page}, {figure.states!r}"
    times = len(_pattern(figure.states).findall((root / figure.page).read_text(encoding="utf-8")))
    if times != 1:
        stated = "does not state this" if not times else f"states this {times} times: add words around it"
        raise FigureMismatch(f"{where}: the page {stated}")
    path = root / figure.kept
    if not path.exists():
        raise FigureMismatch(f"{where}: {figure.kept} does not exist")
    try:
        values = [read_value(path, address) for address in figure.values]
        given = figure.format.format(*values)
    except (ValueError, LookupError) as error:
        raise FigureMismatch(f"{where}: {figure.kept}: {error}") from error
    if given != figure.states:
        raise FigureMismatch(f"{where}: {figure.kept} gives {given!r}")


def read_value(path: Path, address: str) -> Any:
    """Return one kept value: by a dotted path in JSON, else from the rows of a table."""
    if path.suffix != ".json":
        return _value_of_rows(list(_rows(path)), address)
    value = json.loads(path.read_text(encoding="utf-8"))
    for name in address.split("."):
        try:
            value = value[int(name)] if isinstance(value, list) else value[name]
        except (LookupError, TypeError, ValueError):
            raise LookupError(f"{address}: there is no {name!r}") from None
    return value


def _value_of_rows(rows: Sequence[Row], address: str) -> Any:
    what, conditions, column = address.split(":", 2)
    named = dict(one.split("=", 1) for one in conditions.split(";") if one)
    chosen = [row for row in rows if column in row and all(_meets(row, *one) for one in named.items())]
    if what == "row":
        if len(chosen) != 1:
            raise LookupError(f"{address}: {len(chosen)} rows, expected one")
        return _number(chosen[0][column])
    cells = [row[column] for row in chosen]
    values = [_number(one) for cell in cells for one in (cell if isinstance(cell, list) else [cell])]
    if what != "count" and not values:
        raise LookupError(f"{address}: no rows")
    return STATISTICS[what](values)


def _meets(row: Row, column: str, wanted: str) -> bool:
    if column not in row:
        return False
    value = _number(row[column])
    bounds = re.fullmatch(r"(-?[\d.]+?)\.\.(-?[\d.]+)", wanted)
    if bounds:
        return isinstance(value, float) and float(bounds[1]) <= value <= float(bounds[2])
    return bool(value == _number(wanted))


def _number(cell: Any) -> Any:
    if isinstance(cell, str):
        text = cell.strip().replace(",", "")
        return float(text) if re.fullmatch(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", text) else cell.strip()
    return float(cell) if isinstance(cell, int | float) and not isinstance(cell, bool) else str(cell).lower()


def _rows(path: Path) -> Iterator[Row]:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".jsonl":
        yield from map(json.loads, text.splitlines())
    elif path.suffix == ".csv":
        lines = list(csv.reader(text.splitlines()))
        for cells in lines[1:]:
            yield dict(reversed(list(zip(lines[0], cells, strict=True))))  # the first of two alike counts
    else:
        yield from _rows_of_markdown(text)


def _rows_of_markdown(text: str) -> Iterator[Row]:
    """Yield the rows of all tables; `heading` is the nearest one above."""
    header: list[str] = []
    headings: dict[int, str] = {}
    for line in text.splitlines():
        if found := re.match(r"(#+) (.+)", line):
            level = len(found[1])
            headings = {depth: name for depth, name in headings.items() if depth < level} | {level: found[2]}
        cells = [cell.strip().strip("`*") for cell in line.split("|")[1:-1]] if line.startswith("|") else []
        if not cells:
            header = []
        elif not header:
            header = cells
        elif not set("".join(cells)) <= set("-:"):
            row = dict(reversed(list(zip(header, cells, strict=False))))
            yield {"heading": " / ".join(headings[depth] for depth in sorted(headings)), **row}


FIGURE = re.compile(r"(?<![\w.])(?<![A-Za-z]-)\d[\d,]*(?:\.\d+|(?= ?(?:mm|µm|mrad|%)))")
# A fence of code, code in a line, the target of a link, a heading, and the first column of a table: a label.
_NO_CLAIM = re.compile(r"^```.*$|`[^`\n]*`|\]\([^)\s]*\)|^#.*$|^\|[^|\n]*", re.MULTILINE)


def uncovered(page: str, stated: Sequence[str], root: Path = ROOT) -> list[str]:
    """Return each figure of a page, with the words about it, that none of these words contains.

    Figures are decimal numbers, and whole ones in mm, µm, mrad or per cent.
    """
    text = (root / page).read_text(encoding="utf-8")
    claims = _NO_CLAIM.sub(lambda found: " " * len(found[0]), text).replace("\n", " ")
    covered = np.zeros(len(text), dtype=bool)
    for words in stated:
        for found in _pattern(words).finditer(text):
            covered[found.start() : found.end()] = True
    return [
        claims[max(0, found.start() - 40) : found.end() + 25].strip()
        for found in FIGURE.finditer(claims)
        if not covered[found.start() : found.end()].all()
    ]


def _pattern(words: str) -> re.Pattern[str]:
    """Return a pattern of these words, which may cross a page's line breaks."""
    return re.compile(r"\s+".join(map(re.escape, words.split())))
