"""Turns of the tool about its axis to try: from the planned free angle outwards, to both sides."""

from __future__ import annotations

import math

STEP_RAD = math.radians(10.0)
FURTHEST_RAD = math.radians(90.0)

OUTWARDS_RAD: tuple[float, ...] = (
    0.0,
    *(side * step * STEP_RAD for step in range(1, round(FURTHEST_RAD / STEP_RAD) + 1) for side in (1, -1)),
)
