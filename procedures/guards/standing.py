"""The guards of every procedure, in the order in which they are asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.guards.arm_link import ArmLink
from procedures.guards.disk_space import DiskSpace
from procedures.guards.head_in_sight import HeadInSight
from procedures.guards.line_of_sight import LineOfSight
from procedures.guards.motion_watch import MotionWatch
from procedures.guards.mounted_tool import ToolStillMounted
from procedures.guards.wall_clock import WallClock
from procedures.operator.checkpoint import Guard
from procedures.workcell import Workcell
from ronna_hw.clock import Clock
from ronna_hw.errors import RonnaError

Void = Callable[[RonnaError], None]


def standing_guards(
    workcell: Workcell,
    folder: Path,
    clock: Clock,
    find: Callable[[str], None],
    doubt_tool: Callable[[str], None],
) -> tuple[Guard, ...]:
    """Those that hold from the first step to the last. `find` records what the operator should know.

    `doubt_tool` is told that another tool was found than the checked one.
    """
    return (
        DiskSpace(folder),
        WallClock(find),
        ArmLink(workcell),
        ToolStillMounted(workcell, doubt_tool),
        LineOfSight(workcell.tracker, workcell.calibrations.tracker_frame.tool, clock.now_s),
    )


def patient_watch(engine: Engine, void: Void) -> MotionWatch:
    """The watch of the patient while the arm moves; `void` ends what no longer holds when the head moves."""
    setting = engine.setting
    return MotionWatch(
        setting.workcell,
        setting.clock,
        setting.memory,
        setting.settings.watch_patient,
        find=engine.find,
        tell=lambda text: engine.events.publish(Advisory(text=text)),
        void=void,
        beside=engine.checkpoint.beside,
    )


def sight_guard(engine: Engine, void: Void) -> HeadInSight:
    """The guard that bounds how long a guide approaches a head that nothing sees; `void` as there."""
    setting = engine.setting
    return HeadInSight(setting.workcell, setting.clock, setting.memory, void)
