"""Choices offered by commands, importable without heavy dependencies."""

from __future__ import annotations

from enum import StrEnum


class OnStand(StrEnum):
    """Objects that the calibration stand can hold: the ball, or the divot on a slide with three dials."""

    NOTHING = "nothing"
    BALL = "ball"
    DIVOT = "divot"


class InstrumentKind(StrEnum):
    """Kinds of instrument in the head of a postoperative scan."""

    ELECTRODE = "electrode"
    NEEDLE = "needle"
    DRILL_HOLE = "drill-hole"


class Carrier(StrEnum):
    """Fixation of a named scene's spheres: on individual screws, or on the x-shaped frame."""

    FREE = "free"
    XFRAME = "xframe"
