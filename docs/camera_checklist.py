"""The table of the camera's checklist: each line, the cases that look at it, what they leave out."""

from __future__ import annotations

from ronna_hw.conformance.gige_checklist import LINES, REMARKS, cases_by_line
from ronna_hw.conformance.stereo import SUITE

HEAD = """# Checklist of a GigE Vision camera

`ronna-conformance stereo` runs these cases on the simulated cameras (`--sim`) or on any endpoints, hardware
included, each on both cameras. They leave the cameras with their default user set and nobody in control. The
report says of each case that was left out why. Cases S belong to any stereo pair and have no line here.

| line | what it asks | cases | |
|---|---|---|---|
"""


def camera_checklist_page() -> str:
    """The whole page."""
    rows = [
        f"| {line} | {LINES[line]} | {', '.join(cases) or '-'} | {REMARKS.get(line, '')} |"
        for line, cases in cases_by_line([case.number for case in SUITE.cases]).items()
    ]
    return HEAD + "\n".join(rows) + "\n"
