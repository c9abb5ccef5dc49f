"""The workcell: the only interface through which procedures take looks and move an arm."""

from procedures.workcell.arm_history import InsertionAxis
from procedures.workcell.tools import MountedTool
from procedures.workcell.workcell import Workcell

__all__ = ["InsertionAxis", "MountedTool", "Workcell"]
