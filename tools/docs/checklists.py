"""The tables of the conformance checklists: each line, the cases that look at it, what they leave out."""

from __future__ import annotations

from ronna_hw.conformance import robot, stereo, tracker
from ronna_hw.conformance.case import Suite
from ronna_hw.conformance.protocol import composed, load_protocol

POLARIS_HEAD = """# Checklist of the Polaris protocol

`ronna-conformance tracker` runs these cases on the simulator (`--sim`) or on any endpoint, hardware included.
Nothing that it does by default outlives it: no stored parameter is changed, nothing moves, and the unit is
left idle at 9600 baud. What resets the unit needs `--allow destructive`. The report says of each case that
was left out why.

S is about the unit, D about its driver; T cases belong to any tracker.
"""
KUKA_HEAD = """# Checklist of KUKA's RSI and EKI

`ronna-conformance robot` runs these cases on the simulator (`--sim`) or on any endpoints, hardware included.
What moves the arm needs `--allow motion` and, but for our simulator, the name of a person beside it: it is
asked for, or given by `--confirmed-by`. What ends a run by a fault needs `--allow destructive`. The report
says of each case that was left out why, and who has confirmed the motion.

S is about the controller (cases K), D about the driver (cases L); R cases belong to any robot.
"""
GIGE_HEAD = """# Checklist of a GigE Vision camera

`ronna-conformance stereo` runs these cases on the simulated cameras (`--sim`) or on any endpoints, hardware
included, each on both cameras. They leave the cameras with their default user set and nobody in control. The
report says of each case that was left out why. Cases S belong to any stereo pair and have no line here.
"""
TABLE = """
| line | what it asks | cases | |
|---|---|---|---|
"""


def checklist_pages() -> dict[str, str]:
    """File name -> content of the page of every checklist."""
    return {
        "camera-checklist.md": _page(GIGE_HEAD, stereo.SUITE, "gige-vision"),
        "polaris-checklist.md": _page(POLARIS_HEAD, tracker.SUITE, "ndi-polaris"),
        "robot-checklist.md": _page(KUKA_HEAD, robot.SUITE, "kuka-rsi-eki"),
    }


def _page(head: str, generic: Suite, wire_protocol: str) -> str:
    protocol = load_protocol(wire_protocol)
    suite, checklist = composed(generic, protocol), protocol.checklist
    assert checklist is not None, f"{wire_protocol} has a checklist"
    rows = [
        f"| {line} | {checklist.lines[line]} | {', '.join(cases) or '-'} | {checklist.remark(line)} |"
        for line, cases in checklist.cases_by_line(case.number for case in suite.cases).items()
    ]
    return head + TABLE + "\n".join(rows) + "\n"
