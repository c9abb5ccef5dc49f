"""Turns of the tool about its axis to try: from the planned free angle outwards, to both sides.

A step of 10 degrees moves the hand that carries the default mount by more than 40 mm, several times the
clearance that a motion needs, so an angle that passes may be between two that do not. `between_rad` returns
those between: steps of 2.5 degrees, about 12 mm at the hand.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

STEP_RAD = math.radians(10.0)
FURTHEST_RAD = math.radians(90.0)

OUTWARDS_RAD: tuple[float, ...] = (
    0.0,
    *(side * step * STEP_RAD for step in range(1, round(FURTHEST_RAD / STEP_RAD) + 1) for side in (1, -1)),
)


def between_rad(turns_rad: Iterable[float]) -> tuple[float, ...]:
    """Turns within half a step of each of `turns_rad`, the nearest first, without themselves; each once."""
    found: dict[int, float] = {}
    for turn in turns_rad:
        for quarters in (1, -1, 2, -2):
            beside = turn + quarters * STEP_RAD / 4.0
            if abs(beside) < FURTHEST_RAD:
                found.setdefault(round(math.degrees(beside) * 1000.0), beside)
    return tuple(found.values())
