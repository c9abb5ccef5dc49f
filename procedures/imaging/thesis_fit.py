"""Centre fits of the thesis' localizer, and the errors that the thesis reports for them.

Free of numerics, since every command imports the table of localizers at start-up.
"""

from __future__ import annotations

from enum import StrEnum


class ThesisFit(StrEnum):
    """Centre fits of the thesis."""

    LINE = "thesis-line"
    SPHERE = "thesis-sphere"


REPORTED_FLE_MM = {ThesisFit.LINE: 0.1685, ThesisFit.SPHERE: 0.1617}  # thesis, table 2
