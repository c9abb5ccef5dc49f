"""What a case keeps in memory apart from its results, such as the voxels of the CT. A restart loses it."""

from __future__ import annotations

from typing import TypeVar, cast

T = TypeVar("T")


class CaseMemory:
    """Holds one object of each type until it is dropped; a step that finds nothing reads the input again."""

    def __init__(self) -> None:
        self._kept: dict[type[object], object] = {}

    def keep(self, value: object) -> None:
        """Keep an object, in place of another of its type."""
        self._kept[type(value)] = value

    def find(self, kind: type[T]) -> T | None:
        """The object of a type, if it is kept."""
        return cast("T | None", self._kept.get(kind))

    def drop(self, kind: type[object]) -> None:
        """Let go of the object of a type."""
        self._kept.pop(kind, None)

    def clear(self) -> None:
        """Let go of everything, as a new program has nothing."""
        self._kept.clear()
