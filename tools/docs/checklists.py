"""The tables of the conformance checklists: each line, the cases that check it, what they leave out."""

from __future__ import annotations

from page_tables import table

from conformance.case import Suite
from conformance.protocol import composed, load_protocol


def checklist(generic: Suite, wire_protocol: str) -> str:
    """The checklist of a protocol, with the cases of its suite."""
    protocol = load_protocol(wire_protocol)
    cases, lines = composed(generic, protocol).cases, protocol.checklist
    assert lines is not None, f"{wire_protocol} has a checklist"
    return table(
        ("line", "requirement", "cases", ""),
        [
            (line, lines.lines[line], ", ".join(numbers) or "-", lines.remark(line))
            for line, numbers in lines.cases_by_line(case.number for case in cases).items()
        ],
    )
