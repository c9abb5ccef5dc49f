"""The mounted tool, according to the last reading of the controller's inputs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from enum import StrEnum

from procedures.workcell.errors import WrongTool
from ronna_hw.calibration import STEREO_HEAD_NUMBER
from ronna_hw.config import Calibrations
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform


class MountedTool(StrEnum):
    """The mounted tool, as far as it has been checked."""

    UNKNOWN = "unchecked tool"
    STEREO_HEAD = "stereo head"
    GUIDE = "guide"


class ToolMount:
    """The mount of one arm. `tool` is what was found there last."""

    def __init__(self, read_number: Callable[[], int], calibrations: Calibrations) -> None:
        self.tool = MountedTool.UNKNOWN
        self._reported: int | None = None  # when the inputs were last read
        self._read_number = read_number
        self._calibrations = calibrations

    @property
    def checked_number(self) -> int | None:
        """The number of the tool that was found last; None while that is not known."""
        return None if self.tool is MountedTool.UNKNOWN else self._number(self.tool)

    def check(self, tool: MountedTool) -> int:
        """The tool's number; raises PRO-009 when another is mounted."""
        expected = self._number(tool)
        self.tool = MountedTool.UNKNOWN
        mounted = self._reported = self._read_number()
        if mounted != expected:
            raise WrongTool(
                f"the {tool} is not mounted",
                expected=f"{tool}, number {expected}",
                got=f"number {mounted} from the controller's inputs",
            )
        self.tool = tool
        return mounted

    def identify(self) -> MountedTool:
        """Whichever tool is mounted; unchecked when it is none of ours or cannot be read."""
        self.tool = MountedTool.UNKNOWN
        with contextlib.suppress(RonnaError):
            mounted = self._reported = self._read_number()
            known = (MountedTool.STEREO_HEAD, MountedTool.GUIDE)
            self.tool = next((tool for tool in known if self._number(tool) == mounted), MountedTool.UNKNOWN)
        return self.tool

    def flange_from(self, tool: MountedTool) -> Transform:
        """FLANGE <- TOOL of a tool, from its calibration record. Raises PRO-009 for an unchecked one."""
        if tool is MountedTool.UNKNOWN:
            known = (f"{each}, number {self._number(each)}" for each in list(MountedTool)[1:])
            raise WrongTool(
                "the mounted tool is not a calibrated one, or has not been checked",
                expected=" or ".join(known),
                got="nothing read yet"
                if self._reported is None
                else f"number {self._reported} when the controller's inputs were last read",
            )
        records = self._calibrations
        record = records.tool_tip if tool is MountedTool.GUIDE else records.stereo_head
        return record.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)

    def _number(self, tool: MountedTool) -> int:
        guide = tool is not MountedTool.STEREO_HEAD
        return self._calibrations.tool_tip.tool_number if guide else STEREO_HEAD_NUMBER
