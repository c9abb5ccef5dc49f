"""The checked tool is still mounted, according to the controller's inputs."""

from __future__ import annotations

from collections.abc import Callable

from procedures.workcell import Workcell
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.errors import RonnaError


class ToolStillMounted:
    """Asks the controller for the tool's number while the arm's stream runs."""

    name = "mounted tool"

    def __init__(self, workcell: Workcell, doubt_tool: Callable[[str], None]) -> None:
        """`doubt_tool` is told that another was found, and may end the step."""
        self._workcell = workcell
        self._doubt_tool = doubt_tool

    def unmet(self) -> str | None:
        """Which tool is reported instead of the one that was checked."""
        workcell = self._workcell
        expected = workcell.checked_tool_number
        if expected is None or workcell.arm.observe().state not in RUNNING:
            return None
        try:
            mounted = workcell.reported_tool_number()
        except RonnaError:
            return None  # what moves the arm meets the same and tells it
        if mounted == expected:
            return None
        reported = f"tool {mounted}" if mounted else "no tool"
        found = f"the controller reports {reported} instead of the {workcell.tool}"
        self._doubt_tool(found)
        return f"{found}: mount the {workcell.tool} again"
