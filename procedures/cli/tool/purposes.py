"""The purposes of tools as words of the command line, without loading the theatre file's models."""

from __future__ import annotations

from enum import StrEnum


class Purpose(StrEnum):
    """As `ronna_hw.tool_record.ToolPurpose`."""

    STEREO_HEAD = "stereo_head"
    NEEDLE_GUIDE = "needle_guide"
    DRILL_GUIDE = "drill_guide"
    DRILL = "drill"
    GRIPPER = "gripper"
    POINTER = "pointer"
