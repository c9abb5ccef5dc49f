"""Command choices, importable without heavy dependencies."""

from __future__ import annotations

from enum import StrEnum
from functools import cached_property


class InstrumentKind(StrEnum):
    """Kinds of instrument in a postoperative scan."""

    ELECTRODE = "electrode"
    NEEDLE = "needle"
    DRILL_HOLE = "drill-hole"


class Carrier(StrEnum):
    """Sphere mounting in a named scene: on individual screws or on the x-shaped frame."""

    FREE = "free"
    XFRAME = "xframe"


class ArmRole(StrEnum):
    """Role of an arm, as the theatre file names it."""

    MASTER = "master"  # carries stereo head and guide; its base is the robot frame
    ASSISTANT = "assistant"  # carries the instrument

    @cached_property  # asked for in each control cycle
    def number(self) -> int:
        """Number from 0, also that of its cycles in the clock."""
        return tuple(ArmRole).index(self)


OTHER_ARMS = tuple(role for role in ArmRole if role is not ArmRole.MASTER)
