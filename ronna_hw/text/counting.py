"""A number of things, in words."""

from __future__ import annotations

from collections.abc import Sequence


def counted(number: int, one: str, several: str | None = None) -> str:
    """`1 mistake`, `2 mistakes`; `several` if the plural is more than an s."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def some_of(names: Sequence[str], shown: int = 5) -> str:
    """The first names, and how many more there are: `a, b and 4 more`."""
    listed = ", ".join(names[:shown])
    return listed if len(names) <= shown else f"{listed} and {len(names) - shown} more"
