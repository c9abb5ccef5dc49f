"""The guards of every procedure, in the order in which they are asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from procedures.engine.checkpoint import Guard
from procedures.guards.arm_link import ArmLink
from procedures.guards.disk_space import DiskSpace
from procedures.guards.line_of_sight import LineOfSight
from procedures.guards.mounted_tool import ToolStillMounted
from procedures.guards.wall_clock import WallClock
from procedures.workcell import Workcell
from ronna_hw.clock import Clock


def standing_guards(
    workcell: Workcell, folder: Path, clock: Clock, find: Callable[[str], None]
) -> tuple[Guard, ...]:
    """Those that hold from the first step to the last. `find` records what the operator should know."""
    return (
        DiskSpace(folder),
        WallClock(find),
        ArmLink(workcell),
        ToolStillMounted(workcell),
        LineOfSight(workcell.tracker, workcell.calibrations.tracker_frame.tool, clock.now_s),
    )
