"""The x-shaped frame of four fiducials as a tool of the tracker."""

from __future__ import annotations

from datetime import date

from drivers.ndi_polaris.rom.definition import ToolDefinition, planar_tool
from ronna_hw.x_frame import NAME, OUTWARD, PART_NUMBER, SPHERE_CENTRES_MM

__all__ = ["NAME", "x_frame"]

MANUFACTURER = "RONNA"
DEFINED_ON = date(2025, 1, 7)


def x_frame() -> ToolDefinition:
    """The definition of the x-shaped frame; markers in mm in its own frame, facing outwards."""
    return planar_tool(PART_NUMBER, SPHERE_CENTRES_MM, OUTWARD, manufacturer=MANUFACTURER, made_on=DEFINED_ON)
