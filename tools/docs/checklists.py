"""The tables of the conformance checklists: each line, the cases that check it, what they leave out."""

from __future__ import annotations

from ronna_hw.conformance import robot, stereo, tracker
from ronna_hw.conformance.case import Suite
from ronna_hw.conformance.protocol import composed, load_protocol

POLARIS_HEAD = """# Checklist of the Polaris protocol

`ronna-conformance tracker` runs these cases on the simulator (`--sim`) or on any endpoint, including
hardware. By default it has no lasting effect: no stored parameter is changed, nothing moves, and the unit is
left idle at 9600 baud. Cases that reset the unit need `--allow destructive`. The report gives a reason for
every skipped case.

S lines are about the unit, D lines about its driver; T cases belong to any tracker.
"""
KUKA_HEAD = """# Checklist of KUKA's RSI and EKI

`ronna-conformance robot` runs these cases on the simulator (`--sim`) or on any endpoints, including hardware.
Cases that move the arm need `--allow motion` and, except on our simulator, the name of a person beside it,
given at the prompt or by `--confirmed-by`. Cases that end in a fault need `--allow destructive`. The report
gives a reason for every skipped case, and names who confirmed the motion.

S lines are about the controller (cases K), D lines about the driver (cases L); R cases belong to any robot.
"""
GIGE_HEAD = """# Checklist of a GigE Vision camera

`ronna-conformance stereo` runs these cases on the simulated cameras (`--sim`) or on any endpoints, including
hardware, each on both cameras. Afterwards the cameras have their default user set and no controlling
application. The report gives a reason for every skipped case. S cases apply to any stereo pair and are not
listed here.
"""
TABLE = """
| line | requirement | cases | |
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
