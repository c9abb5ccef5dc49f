"""A theatre file with some of its tables replaced, and everything else as a person wrote it, comments too."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

Place = tuple[str, ...]  # of a table: `calibration`, `tool_tip`


def with_tables(text: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """The text with these entries of tables, each in the place of the former one or else at the end.

    What comes out is compared with what was meant: of a text in which these tables have no headers of their
    own the comments are lost.
    """
    import tomli_w

    meant = tomllib.loads(text)
    new: dict[Place, str] = {}
    for name, entries in tables.items():
        meant[name] = {**meant.get(name, {}), **entries}
        new |= {(name, key): tomli_w.dumps({name: {key: entry}}) for key, entry in entries.items()}
    replaced = "".join(_replaced(text, new))
    try:
        kept = tomllib.loads(replaced) == meant
    except tomllib.TOMLDecodeError:
        kept = False
    return replaced if kept else tomli_w.dumps(meant)


def _replaced(text: str, new: dict[Place, str]) -> Iterator[str]:
    """The lines, those of replaced tables left out, with comments that stand before the next header."""
    to_write = dict(new)
    leaving_out, remarks = False, list[str]()
    for line in text.splitlines(keepends=True):
        place = _place(line)
        if place is not None:
            leaving_out = place[:2] in new
            yield from remarks
            remarks.clear()
            if leaving_out:
                yield to_write.pop(place[:2], "")
        if not leaving_out:
            yield line
        elif place is None and (not line.strip() or line.lstrip().startswith("#")):
            remarks.append(line)
        else:
            remarks.clear()  # of the record that is replaced
    yield from remarks
    for table in to_write.values():
        yield f"\n{table}"


def _place(line: str) -> Place | None:
    """Of the table whose header a line is."""
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
