"""Help of the planner's page: how to work, what its numbers mean, and what it does not do."""

from __future__ import annotations

from console.panels.html import tag, text
from console.planning.slices import WINDOWS_HU

WAY = (
    "Click a small picture to enlarge it, or choose it under “Large”. The wheel, Page Up and Page Down "
    "change the slice; Ctrl with the wheel, + and − magnify about the crosshair.",
    "A click moves the crosshair; arrow keys move it too, with Shift ten times as far. e and t set entry and "
    "target there. Enter does what a click does.",
    "“measure”: two clicks, also in two pictures or slices; the length is that in space.",
    "“AC–PC”: click the anterior commissure, the posterior, and a midline point far above them. Coordinates "
    "then count from halfway between the commissures: x to the patient's right, y to the front, z up.",
    "L, P, S are the scan's coordinates: to the patient's left, to the back, up. Pictures are seen from the "
    "patient's feet and front: the patient's left is on the right.",
    "“Show”, if an MR or another series was fused: the CT, the other series, or a chequerboard of both. "
    "Edges must run on from square to square. A target set while the other series is shown is marked as "
    "chosen in it, and the error of the fusion counts, until you press “Chosen in the CT”. Of a "
    "structure drawn there, include that error in its margin. Windows are for the CT alone.",
    f"Windows: {', '.join(f'{name} {low:g} to {high:g} HU' for name, (low, high) in WINDOWS_HU.items())}.",
    "Check, Reach and Expected error follow every change. Save seals the plan under your name.",
)
LIMITS = (
    "It is research software, not a certified medical device: never operate on the strength of its plan "
    "alone.",
    "It does not fuse an MR itself: that is done before, and whoever set up the planner opens it with both. "
    "Commissures are hard to see in CT.",
    "It has no atlas and finds no vessel by itself: draw or import what a trajectory must keep away from.",
    "Its distances are those of the scan: a brain that shifts after the skull is opened is not in it.",
    "Reach is checked for the place where the head is assumed; the case checks it again where the head is.",
)


def help_html() -> str:
    return "".join(
        tag("h3", title) + tag("ul", "".join(tag("li", text(line)) for line in lines), class_="findings")
        for title, lines in (("How to work", WAY), ("What this planner does not do", LIMITS))
    )
