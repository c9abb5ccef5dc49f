"""Findings of the comparison after a restart: what is as recorded, and what differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from pydantic import BaseModel

from ronna_hw.text import counted


@dataclass
class Comparison:
    """Findings in plain words. Any difference is refused, whatever the operator answers."""

    warnings: list[str] = field(default_factory=list)  # potential harm: read first
    notes: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)  # what is as recorded
    differences: list[str] = field(default_factory=list)

    @property
    def findings(self) -> list[str]:
        """All but the differences, as journalled."""
        return [*self.warnings, *self.notes, *(f"{what}: as recorded" for what in self.unchanged)]

    def same(self, what: str) -> None:
        """Add something that was compared and is as recorded."""
        self.unchanged.append(what)

    def note(self, text: str) -> None:
        """Add something the operator should know."""
        self.notes.append(text)

    def warn(self, text: str) -> None:
        """Add something the operator must know before anything else."""
        self.warnings.append(text)

    def differs(self, what: str, recorded: object, found: object) -> None:
        """Add something that is not as recorded."""
        self.differences.append(f"{what}: recorded {recorded}, found {found}")

    def refuse(self, text: str) -> None:
        """Add something else for which the run is not resumed."""
        self.differences.append(text)

    def compare(self, what: str, recorded: BaseModel | None, found: BaseModel | None) -> None:
        """Note it as unchanged, or as different with the fields that differ."""
        if recorded == found:
            self.same(what)
        elif recorded is None or found is None:
            self.differs(what, "none" if recorded is None else "one", "none" if found is None else "one")
        else:
            unlike = list(_unlike(recorded, found))
            self.differs(
                what,
                ", ".join(f"{name} {then}" for name, then, _ in unlike),
                ", ".join(f"{name} {now}" for name, _, now in unlike),
            )

    def in_lines(self, order: Sequence[str]) -> str:
        """Warnings, what will be done in `order`, and the findings; unchanged items on one line."""
        as_recorded = [counted(len(self.unchanged), "item") + " as recorded"] if self.unchanged else []
        return "\n".join((*self.warnings, *order, *self.notes, *as_recorded))


def _unlike(recorded: BaseModel, found: BaseModel, within: str = "") -> Iterator[tuple[str, object, object]]:
    """Dotted names of the fields that differ, with both values; for a sequence the number of entries."""
    for name in type(recorded).model_fields:
        then, now = getattr(recorded, name), getattr(found, name, None)
        if then == now:
            continue
        if isinstance(then, BaseModel) and isinstance(now, BaseModel):
            yield from _unlike(then, now, f"{within}{name}.")
        else:
            yield f"{within}{name}", _in_short(then), _in_short(now)


def _in_short(value: object) -> object:
    if value and isinstance(value, tuple) and all(isinstance(one, int | float) for one in value):
        return value
    return counted(len(value), "entry", "entries") if isinstance(value, list | tuple | dict) else value
