"""A numbered checklist of a wire protocol, and which cases check which line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property


@dataclass(frozen=True)
class Checklist:
    """The lines of one protocol, numbered from 1.

    A case's number assigns it to a line: one of `letters`, the line, and a lower-case letter if a line has
    several cases. `also` names generic cases that also check a line. `elsewhere` says where a line without a
    case is tested, `remarks` what a line's cases leave out.
    """

    letters: str
    lines: Mapping[int, str]
    remarks: Mapping[int, str] = field(default_factory=dict)
    elsewhere: Mapping[int, str] = field(default_factory=dict)
    also: Mapping[int, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def _number(self) -> re.Pattern[str]:
        return re.compile(rf"[{self.letters}](\d+)[a-z]?")

    def line_of(self, number: str) -> int | None:
        """The line checked by a case; None for a generic case."""
        match = self._number.fullmatch(number)
        return int(match[1]) if match else None

    def cases_by_line(self, numbers: Iterable[str]) -> dict[int, tuple[str, ...]]:
        """Line -> numbers of the cases that check it, for every line."""
        known = tuple(numbers)
        own = {line: [number for number in known if self.line_of(number) == line] for line in self.lines}
        return {
            line: (*own[line], *(number for number in self.also.get(line, ()) if number in known))
            for line in self.lines
        }

    def remark(self, line: int) -> str:
        """Where a line is tested, or what its cases leave out; empty without a remark."""
        return self.elsewhere.get(line) or self.remarks.get(line, "")
