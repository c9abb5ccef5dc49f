"""Ranges of the values in a scene."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from ronna_hw.calibration import Numbers3
from ronna_hw.plausible import FARTHEST_ON_TOOL_MM, LONGEST_NAME, NAME_PATTERN, SHORTEST_MM, farther_than
from ronna_hw.wire.gige_vision import TEXT_BYTES, Bootstrap
from ronna_hw.wire.polaris_rom import PART_NUMBER_BYTES, ROM_MARKERS, ROM_MINIMUM_MARKERS

UNIT_TOLERANCE = 1e-3  # on the length of a unit vector

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
# A camera's register is 0-terminated; a longer number would be reported cut off.
Serial = Annotated[
    str, Field(min_length=1, max_length=TEXT_BYTES[Bootstrap.SERIAL_NUMBER] - 1, pattern=r"^[!-~]+$")
]
# The theatre writes the definition into a file of this name, and fault scripts name the tool by it.
ToolName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=NAME_PATTERN)]
# A definition holds ASCII; a longer number would be cut off, and the tool not found by it.
PartNumber = Annotated[str, Field(min_length=1, max_length=PART_NUMBER_BYTES, pattern=r"^[ -~]+$")]


def _as_many_as_defined(markers_mm: tuple[Numbers3, ...]) -> tuple[Numbers3, ...]:
    # Not a length constraint on the field, whose message would suspect a decimal comma.
    if not ROM_MINIMUM_MARKERS <= len(markers_mm) <= ROM_MARKERS:
        raise ValueError(
            f"a tool definition has {ROM_MINIMUM_MARKERS} to {ROM_MARKERS} markers, got {len(markers_mm)}"
        )
    return markers_mm


def _unit(direction: Numbers3) -> Numbers3:
    if abs((length := math.hypot(*direction)) - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"has length {length:.3g}, expected a unit vector")
    return direction


OnTool = Annotated[Numbers3, farther_than(SHORTEST_MM, FARTHEST_ON_TOOL_MM)]
MarkerCentres = Annotated[tuple[OnTool, ...], AfterValidator(_as_many_as_defined)]
Facing = Annotated[Numbers3, AfterValidator(_unit)]
