"""Picture of true, registered and reached target, as figure 8 of the thesis has them.

The three points span a plane, in which they are drawn to scale. Where the registration is wrong by as much as
the arm that trusts it, the two cancel: their vectors add up, not their lengths (eq. 40 to 42).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from procedures.reporting.numbers import millimetres
from procedures.reporting.outcome import ErrorParts
from procedures.reporting.pictures import AMBER, BLUE, GREY, TEXT_SIZE, WIDTH, Canvas
from procedures.reporting.tables import TargetRow

ROW = 52.0  # height of a target, without its picture
LINE = 12.0
MARGIN = 24.0
DOT = 3.0  # half the size of a point
ARROW = 1.5  # width of a line


@dataclass(frozen=True)
class ErrorTriangle:
    """True target at the origin, with registered and reached target in their plane; mm, x along the first."""

    registered_mm: tuple[float, float]
    reached_mm: tuple[float, float]

    @classmethod
    def of(cls, parts: ErrorParts) -> ErrorTriangle:
        """Lay the plane of both vectors flat."""
        along_mm = math.hypot(*parts.registration_mm)
        error_mm = [a + b for a, b in zip(parts.registration_mm, parts.intrinsic_mm, strict=True)]
        if along_mm == 0.0:
            return cls((0.0, 0.0), (math.hypot(*error_mm), 0.0))
        x_mm = sum(a * b for a, b in zip(parts.registration_mm, error_mm, strict=True)) / along_mm
        y_mm = math.sqrt(max(0.0, math.hypot(*error_mm) ** 2 - x_mm**2))
        return cls((along_mm, 0.0), (x_mm, y_mm))

    @property
    def left_mm(self) -> float:
        return min(0.0, self.reached_mm[0])

    @property
    def right_mm(self) -> float:
        return max(self.registered_mm[0], self.reached_mm[0])


def parts_figure(rows: Sequence[TargetRow]) -> str:
    """Draw true (grey), registered (amber) and reached (blue) target of each row, all to one scale."""
    drawn = [(row, row.parts, ErrorTriangle.of(row.parts)) for row in rows if row.parts is not None]
    across_mm = max(one.right_mm - one.left_mm for *_, one in drawn)
    down_mm = max(one.reached_mm[1] for *_, one in drawn)
    scale = (WIDTH - 2 * MARGIN) / max(across_mm, 1e-6)
    row_height = ROW + scale * down_mm
    canvas = Canvas(row_height * len(drawn), "True, registered and reached target, mm")
    for number, (row, parts, one) in enumerate(drawn):
        top = row_height * number
        lengths = ", ".join(
            f"{name} {millimetres(parts.lengths_mm[part])}"
            for name, part in (("registration", "registration"), ("arm", "intrinsic"))
        )
        canvas.text(0, top + LINE, f"{row.target}: {lengths}, together {millimetres(row.error_mm)}")
        places = [
            (MARGIN + (x_mm - one.left_mm) * scale, top + ROW - 2 * TEXT_SIZE + y_mm * scale)
            for x_mm, y_mm in ((0.0, 0.0), one.registered_mm, one.reached_mm)
        ]
        for (x1, y1), (x2, y2), colour in zip(places, places[1:], (AMBER, BLUE), strict=False):
            canvas.line(x1, y1, x2, y2, f'stroke="{colour}" stroke-width="{ARROW:g}"')
        for (x, y), colour in zip(places, (GREY, AMBER, BLUE), strict=True):
            canvas.rectangle(x - DOT, y - DOT, 2 * DOT, 2 * DOT, colour)
    return canvas.svg
