"""Order of the points of a drawn line; a module of its own, so that command options import nothing heavy."""

from __future__ import annotations

from enum import StrEnum


class LineOrder(StrEnum):
    """Order in which the two points of a line were placed."""

    ENTRY_FIRST = "entry-first"
    TARGET_FIRST = "target-first"
