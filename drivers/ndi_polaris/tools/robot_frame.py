"""The robot's reference frame M: four spheres on the tool mount, seen by the tracker."""

from __future__ import annotations

from datetime import date

from drivers.ndi_polaris.rom.definition import ToolDefinition, planar_tool

NAME = "robot_frame"
PART_NUMBER = "RONNA-M"
MANUFACTURER = "RONNA"
# Six distances at least 4 mm apart, so that the pose is unique.
MARKERS_MM = ((0.0, 0.0, 0.0), (45.0, 60.0, 0.0), (-30.0, 85.0, 0.0), (-62.0, 30.0, 12.0))
DEFINED_ON = date(2025, 1, 6)


def robot_frame() -> ToolDefinition:
    """The definition of frame M; markers in mm in its own frame, all facing along z."""
    return planar_tool(PART_NUMBER, MARKERS_MM, manufacturer=MANUFACTURER, made_on=DEFINED_ON)
