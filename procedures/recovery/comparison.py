"""What a comparison after a restart found: what is as it was recorded, and what differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ronna_hw.text.counting import counted


@dataclass
class Comparison:
    """Findings in plain words. A difference is refused, whatever the operator says."""

    warnings: list[str] = field(default_factory=list)  # what can hurt: read first
    notes: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)  # what is as recorded
    differences: list[str] = field(default_factory=list)

    @property
    def findings(self) -> list[str]:
        """All but the differences, as the journal has them."""
        return [*self.warnings, *self.notes, *(f"{what}: as recorded" for what in self.unchanged)]

    def same(self, what: str) -> None:
        """That was compared and is as recorded."""
        self.unchanged.append(what)

    def note(self, text: str) -> None:
        """The operator should know this."""
        self.notes.append(text)

    def warn(self, text: str) -> None:
        """The operator must know this before anything else."""
        self.warnings.append(text)

    def differs(self, what: str, recorded: object, found: object) -> None:
        """That is not as it was recorded."""
        self.differences.append(f"{what}: recorded {recorded}, found {found}")

    def in_lines(self, order: Sequence[str]) -> str:
        """What can hurt, what will be done in `order`, what was found; what is as it was in one line."""
        as_recorded = [counted(len(self.unchanged), "item") + " as recorded"] if self.unchanged else []
        return "\n".join((*self.warnings, *order, *self.notes, *as_recorded))
