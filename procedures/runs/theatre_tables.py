"""Replacement of tables in the text of a theatre file, keeping the comments."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, Comment, Item, Table, Whitespace

from ronna_hw.config import BadTheatreFile


def replace_tables(text: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Return TOML text with the table entries replaced, or added if they are new; all else stays as written.

    Raises CFG-001 if the text is written in such a way that other entries would change.
    """
    intended_content = tomllib.loads(text)
    document = tomlkit.parse(text)
    for name, entries in tables.items():
        as_read = tomllib.loads(tomlkit.dumps(dict(entries)))  # a tuple is written as a list
        intended_content[name] = {**intended_content.get(name, {}), **as_read}
        document.setdefault(name, tomlkit.table(is_super_table=True))
        for key, entry in entries.items():
            table = document[name]  # anew each time: of a table in several places this is a copy
            remarks = _take_remarks(table.get(key, table))
            table[key] = entry
            end = _last_table(document[name][key]) or document[name]
            for remark in remarks:
                end.add(remark)
    replaced = tomlkit.dumps(document)
    if tomllib.loads(replaced) != intended_content:
        raise BadTheatreFile(
            f"cannot replace {', '.join(tables)} without changing other entries",
            expected="tables with headers, such as [calibration.tool_tip], and no dotted keys",
            action="Write these tables with headers and repeat the command; nothing was changed.",
        )
    return replaced


def _take_remarks(entry: Item) -> list[Comment | Whitespace]:
    """Remove the comments at the end of a table: they belong to the next header, but are parsed into it."""
    remarks: list[Comment | Whitespace] = []
    if (last := _last_table(entry)) is not None:
        body = last.value.body
        while body and isinstance(remark := body[-1][1], Comment | Whitespace):
            remarks.insert(0, remark)
            body.pop()
    return remarks


def _last_table(entry: Item) -> Table | None:
    """Return the table that ends the text of an entry; None for an entry without a header."""
    if isinstance(entry, AoT):
        return _last_table(entry[-1])
    if not isinstance(entry, Table):
        return None
    return (_last_table(entry.value.body[-1][1]) if entry.value.body else None) or entry
