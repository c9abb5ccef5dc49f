"""Objects that fit on the calibration stand on the table."""

from __future__ import annotations

from enum import StrEnum


class OnStand(StrEnum):
    """Its content: the ball, or in its place the divot on a slide with three dials."""

    NOTHING = "nothing"
    BALL = "ball"
    DIVOT = "divot"
