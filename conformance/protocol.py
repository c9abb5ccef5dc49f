"""Wire protocol cases, discovered through entry points.

A package with a driver for its own protocol can also provide cases for it::

    [project.entry-points."ronna_hw.conformance"]
    my-protocol = "my_package.conformance:PROTOCOL"

They follow the generic cases if the driver's `wire_protocol` has that name.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import entry_points

from conformance.case import Suite, SuiteCase
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.registry import load_driver


@dataclass(frozen=True)
class Checklist:
    """Numbered checklist of a wire protocol, with lines numbered from 1.

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
        """Return the checklist line of a case, or None for a generic case."""
        match = self._number.fullmatch(number)
        return int(match[1]) if match else None

    def cases_by_line(self, numbers: Iterable[str]) -> dict[int, tuple[str, ...]]:
        """Map every checklist line to the cases that check it."""
        known = tuple(numbers)
        own = {line: [number for number in known if self.line_of(number) == line] for line in self.lines}
        return {
            line: (*own[line], *(number for number in self.also.get(line, ()) if number in known))
            for line in self.lines
        }

    def remark(self, line: int) -> str:
        """Return where a line is tested or what its cases omit; empty if there is no remark."""
        return self.elsewhere.get(line) or self.remarks.get(line, "")


GROUP = "ronna_hw.conformance"


@dataclass(frozen=True)
class ProtocolCases:
    """Cases of a package for one wire protocol.

    `offers` names the needs that it can meet for a given device under test. `simulator` returns the arguments
    of `ronna-sim` for a device that speaks the protocol.
    """

    cases: tuple[SuiteCase, ...] = ()
    checklist: Checklist | None = None
    offers: Callable[[DeviceUnderTest], frozenset[str]] = lambda _dut: frozenset()
    simulator: Callable[[], tuple[str, ...]] | None = None


def load_protocol(wire_protocol: str) -> ProtocolCases:
    """Load the cases that installed packages provide for a wire protocol, if any."""
    for point in entry_points(group=GROUP, name=wire_protocol):
        found: ProtocolCases = point.load()
        return found
    return ProtocolCases()


def load_driver_protocol(driver: str) -> ProtocolCases:
    """Load the cases for the wire protocol of a driver class; raises DEV-002."""
    return load_protocol(load_driver(driver).wire_protocol)


def compose_suite(suite: Suite, protocol: ProtocolCases) -> Suite:
    """Append protocol cases to a suite; raises ValueError if a number is repeated."""
    cases = (*suite.cases, *protocol.cases)
    counts = Counter(case.number for case in cases)
    if repeated := [number for number, count in counts.items() if count > 1]:
        raise ValueError(f"several cases have the number {', '.join(repeated)}")
    return suite.with_cases(cases)
