"""Replacement of tables in the text of a theatre file, keeping the comments."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

TablePath = tuple[str, ...]  # of a table: `calibration`, `tool_tip`


def with_tables(text: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Return TOML text with the table entries replaced, or appended if they are new.

    The outcome is compared with the intended content: if these tables have no headers of their own, comments
    are lost.
    """
    import tomli_w

    intended_content = tomllib.loads(text)
    new: dict[TablePath, str] = {}
    for name, entries in tables.items():
        intended_content[name] = {**intended_content.get(name, {}), **entries}
        new |= {(name, key): tomli_w.dumps({name: {key: entry}}) for key, entry in entries.items()}
    replaced = "".join(_remove_tables(text, new))
    try:
        kept = tomllib.loads(replaced) == intended_content
    except tomllib.TOMLDecodeError:
        kept = False
    return replaced if kept else tomli_w.dumps(intended_content)


def _remove_tables(text: str, new: dict[TablePath, str]) -> Iterator[str]:
    """Yield the lines of TOML text, replacing existing tables by those in `new` and appending the rest.

    Comments in front of the next header are kept.
    """
    to_write = dict(new)
    skipping, remarks = False, list[str]()
    for line in text.splitlines(keepends=True):
        place = _parse_header(line)
        if place is not None:
            skipping = place[:2] in new
            yield from remarks
            remarks.clear()
            if skipping:
                yield to_write.pop(place[:2], "")
        if not skipping:
            yield line
        elif place is None and (not line.strip() or line.lstrip().startswith("#")):
            remarks.append(line)
        else:
            remarks.clear()  # of the record that is replaced
    yield from remarks
    for table in to_write.values():
        yield f"\n{table}"


def _parse_header(line: str) -> TablePath | None:
    """Parse a TOML table header into the table's path; return None for any other line."""
    if not line.lstrip().startswith("["):
        return None
    try:
        inner: Any = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return None
    place: list[str] = []
    while inner:
        if isinstance(inner, list):
            inner = inner[0]
        else:
            ((name, inner),) = inner.items()
            place.append(name)
    return tuple(place)
