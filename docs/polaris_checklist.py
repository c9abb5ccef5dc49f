"""The table of the Polaris checklist: each line, the cases that look at it, or why there is none."""

from __future__ import annotations

from ronna_hw.conformance.polaris_checklist import ELSEWHERE, LINES, REMARKS, cases_by_line
from ronna_hw.conformance.tracker import SUITE

HEAD = """# Checklist of the Polaris protocol

`ronna-conformance tracker` runs these cases on the simulator (`--sim`) or on any endpoint, hardware included.
Nothing that it does by default outlives it: no stored parameter is changed, nothing moves, and the unit is
left idle at 9600 baud. What resets the unit needs `--allow destructive`. The report says of each case that
was left out why.

S is about the unit, D about its driver; T cases belong to any tracker.

| line | what it asks | cases | |
|---|---|---|---|
"""


def checklist_page() -> str:
    """The whole page."""
    rows = []
    for line, cases in cases_by_line(SUITE.cases).items():
        remark = ELSEWHERE.get(line) or REMARKS.get(line, "")
        rows.append(f"| {line} | {LINES[line]} | {', '.join(cases) or '-'} | {remark} |")
    return HEAD + "\n".join(rows) + "\n"
