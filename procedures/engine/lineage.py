"""The results of a run and their ancestors, drawn as text or as a mermaid chart."""

from __future__ import annotations

from procedures.engine.run_folder import RunFolder

SUPERSEDED = "superseded"


def lineage_text(run: RunFolder) -> str:
    """Every result with the results it was made from, each with its own further in.

    A result that was drawn before is only named again: what it was made from stands where it came first.
    """
    parents_of = {record.identifier: tuple(record.parents) for record in run.records}
    used = {name for parents in parents_of.values() for name in parents}
    drawn: set[str] = set()
    lines: list[str] = []
    waiting = [(name, 0) for name in parents_of if name not in used]
    while waiting:
        name, depth = waiting.pop()
        parents = parents_of.get(name)
        again = bool(parents) and name in drawn
        if parents is not None and not again:
            drawn.add(name)
            waiting += [(parent, depth + 1) for parent in reversed(parents)]
        mark = " (not in this run)" if parents is None else f" ({SUPERSEDED})" * (name in run.superseded)
        lines.append(f"{'  ' * depth}{name}{mark}{' ...' if again else ''}")
    return "\n".join(lines) + "\n"


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
