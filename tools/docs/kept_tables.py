"""Tables of the pages that are wholly made of kept results, written between two marks of their page.

`docs/reference/figures/README.md` describes the entries that are read here. `make docs` writes the
tables, and a test compares each with its page.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stated_figures import FOLDER, ROOT, read_value

Fields = Mapping[str, str]


@dataclass(frozen=True)
class KeptRows:
    """Rows of a kept file that give figures to one row of a table."""

    kept: str
    rows: str  # conditions, with fields of the table's row; of JSON the path down to its figures
    what: str = "row"  # or a statistic over all rows that meet them

    def address(self, more: str, column: str, fields: Fields) -> str:
        """Return the address of a column's figure, for a row of the table with these fields."""
        rows = self.rows.format(**fields)
        return f"{rows}.{column}" if self.kept.endswith(".json") else f"{self.what}:{rows};{more}:{column}"


@dataclass(frozen=True)
class TableRows:
    """Rows of a table that share a form."""

    form: str
    figures: Sequence[str]  # SOURCE:COLUMN or SOURCE;MORE CONDITIONS:COLUMN, for each brace without a name
    each: Sequence[Fields]  # for each row what the named braces stand for


@dataclass(frozen=True)
class KeptTable:
    """A table of a page, with the kept results that all its figures come from."""

    page: str
    name: str
    command: str
    header: str
    sources: Mapping[str, KeptRows]
    rows: Sequence[TableRows]

    @property
    def marks(self) -> tuple[str, str]:
        """First and last line of its block."""
        return f"<!-- {self.name}: written by tools/docs/kept_tables.py -->", f"<!-- end of {self.name} -->"

    def write(self, root: Path = ROOT) -> str:
        """Return its block, from mark to mark."""
        begin, end = self.marks
        line = "|" + "---|" * (self.header.count("|") - 1)
        return "\n".join([begin, "", self.header, line, *self._write_rows(root), "", end])

    def _write_rows(self, root: Path) -> Iterator[str]:
        for rows in self.rows:
            for fields in rows.each:
                yield rows.form.format(*(self._find(one, fields, root) for one in rows.figures), **fields)

    def _find(self, figure: str, fields: Fields, root: Path) -> Any:
        where, column = figure.split(":", 1)
        name, _, more = where.partition(";")
        source = self.sources[name]
        return read_value(root / source.kept, source.address(more, column, fields))


def read_tables(root: Path = ROOT) -> list[KeptTable]:
    """Read the tables of all topics."""
    return [
        KeptTable(
            **{name: entry[name] for name in ("page", "name", "command", "header")},
            sources={name: KeptRows(**source) for name, source in entry["sources"].items()},
            rows=[TableRows(**rows) for rows in entry["rows"]],
        )
        for path in sorted((root / FOLDER).glob("*.toml"))
        for entry in tomllib.loads(path.read_text(encoding="utf-8")).get("table", ())
    ]


def find_block(table: KeptTable, root: Path = ROOT) -> str:
    """Return the block as it stands on its page; raise LookupError unless it is there once."""
    begin, end = map(re.escape, table.marks)
    found = re.findall(f"{begin}.*?{end}", (root / table.page).read_text(encoding="utf-8"), re.DOTALL)
    if len(found) != 1:
        raise LookupError(f"{table.page} has the block {table.name!r} {len(found)} times, expected once")
    return str(found[0])


def write_pages() -> None:
    """Write all tables into their pages."""
    for table in read_tables():
        page, old = ROOT / table.page, find_block(table)
        page.write_text(page.read_text(encoding="utf-8").replace(old, table.write()), encoding="utf-8")


if __name__ == "__main__":
    write_pages()
