"""What a comparison after a restart found: what is as it was recorded, and what differs."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Comparison:
    """Findings in plain words. A difference is refused, whatever the operator says."""

    findings: list[str] = field(default_factory=list)
    differences: list[str] = field(default_factory=list)

    def same(self, what: str) -> None:
        """That was compared and is as recorded."""
        self.findings.append(f"{what}: as recorded")

    def note(self, text: str) -> None:
        """The operator should know this."""
        self.findings.append(text)

    def differs(self, what: str, recorded: object, found: object) -> None:
        """That is not as it was recorded."""
        self.differences.append(f"{what}: recorded {recorded}, found {found}")
