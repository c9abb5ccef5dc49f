"""Command choices, importable without heavy dependencies."""

from __future__ import annotations

from enum import StrEnum


class InstrumentKind(StrEnum):
    """Kinds of instrument in a postoperative scan."""

    ELECTRODE = "electrode"
    NEEDLE = "needle"
    DRILL_HOLE = "drill-hole"


class ArmChoice(StrEnum):
    """Arm of a named scene."""

    KR6 = "kr6"
    UR5 = "ur5"
    UR5E = "ur5e"


class Carrier(StrEnum):
    """Sphere mounting in a named scene: on individual screws or on the x-shaped frame."""

    FREE = "free"
    XFRAME = "xframe"
