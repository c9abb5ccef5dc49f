"""A number of things, in words."""

from __future__ import annotations


def counted(number: int, one: str, several: str | None = None) -> str:
    """`1 mistake`, `2 mistakes`; `several` if the plural is more than an s."""
    return f"{number} {one if number == 1 else several or one + 's'}"
