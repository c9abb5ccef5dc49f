"""Objects that fit on the calibration stand on the table."""

from __future__ import annotations

from enum import StrEnum


class OnStand(StrEnum):
    """What it holds: its ball, or in the ball's place the divot on a slide with three dials."""

    NOTHING = "nothing"
    BALL = "ball"
    DIVOT = "divot"
