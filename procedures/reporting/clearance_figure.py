"""Clearance of each checked motion of a trajectory, to the head and to anything else, as one picture."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.reporting.numbers import tenths
from procedures.reporting.plan_table import MotionRow
from procedures.reporting.svg import WIDTH, Canvas

HEAD, OTHER = "#1f6f8b", "#9cc5d3"
ROW, BAR, VALUE_ROOM = 40.0, 10.0, 70.0
LONGEST_MM = 200.0  # a longer bar carries no information


def clearance_figure(trajectory: str, motions: Sequence[MotionRow]) -> str:
    """Two bars for each motion, mm."""
    canvas = Canvas(ROW * len(motions) + 4, f"Clearance of the motions of {trajectory}, mm")
    scale = (WIDTH - VALUE_ROOM) / LONGEST_MM
    for number, one in enumerate(motions):
        top = ROW * number
        canvas.text(0, top + 11, f"{_way(one)}{_named(one)}")
        bars = [(one.head_mm, HEAD), (None if one.closest is None else one.closest.distance_mm, OTHER)]
        for place, (value_mm, colour) in enumerate(bars):
            if value_mm is not None:
                length = scale * min(value_mm, LONGEST_MM)
                canvas.rectangle(0, top + 15 + place * (BAR + 1), length, BAR, colour)
                canvas.text(length + 4, top + 24 + place * (BAR + 1), f"{tenths(value_mm)} mm")
    return canvas.svg


def _way(one: MotionRow) -> str:
    """As shown to a reader: spheres count from 1."""
    if one.start == one.end:
        return f"{_place(one.end)}, along the axis"
    return f"{_place(one.start)} → {_place(one.end)}"


def _place(name: str) -> str:
    *_, last = name.split("/")
    kind, _, number = last.partition(" ")
    return f"sphere {int(number) + 1}" if kind == "fiducial" and number.isdigit() else last


def _named(one: MotionRow) -> str:
    return "" if one.closest is None else f"  ({one.closest.first} – {one.closest.second})"
