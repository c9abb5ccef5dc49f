"""The framed target of a straight line: checked once, then plain floats."""

from __future__ import annotations

from typing import NamedTuple, Self

from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Vector3
from ronna_hw.frames import Frame, FrameMismatch, Transform


class LineTarget(NamedTuple):
    """Where the flange goes, and which of its points keeps to a straight line on the way."""

    flange: Pose
    point_in_flange_mm: Vector3

    @classmethod
    def of(cls, target: Transform, flange_from_tool: Transform | None = None) -> Self:
        """The target ROBOT <- FLANGE, or ROBOT <- TOOL with `flange_from_tool`; raises FRM-001 otherwise."""
        if flange_from_tool is None:
            return cls(Pose.from_transform(target), (0.0, 0.0, 0.0))
        flange = Pose.from_transform(target @ tool_in_flange(flange_from_tool).inverse())
        x, y, z = flange_from_tool.translation_mm.tolist()
        return cls(flange, (x, y, z))


def tool_in_flange(flange_from_tool: Transform) -> Transform:
    """The same transform; raises FRM-001 unless it is FLANGE <- TOOL."""
    if (flange_from_tool.target, flange_from_tool.source) != (Frame.FLANGE, Frame.TOOL):
        raise FrameMismatch(
            "a tool needs flange <- tool", got=f"{flange_from_tool.target} <- {flange_from_tool.source}"
        )
    return flange_from_tool
