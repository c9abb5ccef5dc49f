"""The results of a run and their ancestors, drawn as text or as a mermaid chart."""

from __future__ import annotations

from collections.abc import Iterator

from procedures.engine.run_folder import RunFolder
from ronna_hw.records import Record

SUPERSEDED = "superseded"


def lineage_text(run: RunFolder) -> str:
    """Every result with the results it was made from, each with its own further in.

    A result that was drawn before is only named again: what it was made from stands where it came first.
    """
    by_name = {record.identifier: record for record in run.records}
    drawn: set[str] = set()

    def branch(record: Record, depth: int) -> Iterator[str]:
        again = record.identifier in drawn and bool(record.parents)
        drawn.add(record.identifier)
        mark = f" ({SUPERSEDED})" if record.identifier in run.superseded else ""
        yield f"{'  ' * depth}{record.identifier}{mark}{' ...' if again else ''}"
        if not again:
            for name in record.parents:
                if name in by_name:
                    yield from branch(by_name[name], depth + 1)
                else:
                    yield f"{'  ' * (depth + 1)}{name} (not in this run)"

    used = {name for record in run.records for name in record.parents}
    last = [record for record in run.records if record.identifier not in used]
    return "\n".join(line for record in reversed(last) for line in branch(record, 0)) + "\n"


def lineage_mermaid(run: RunFolder) -> str:
    """The same as a chart: an arrow from each result to those that were made from it."""
    number = {record.identifier: place for place, record in enumerate(run.records)}
    lines = ["flowchart TD"]
    for record in run.records:
        gone = record.identifier in run.superseded
        lines.append(f'  r{number[record.identifier]}["{record.identifier}"]' + (f":::{SUPERSEDED}" * gone))
    lines += [
        f"  r{number[name]} --> r{number[record.identifier]}"
        for record in run.records
        for name in record.parents
        if name in number
    ]
    lines.append(f"  classDef {SUPERSEDED} stroke-dasharray: 4 4, color: #888")
    return "\n".join(lines) + "\n"
