"""The workcell: the only way for procedures to take looks and make motions."""

from procedures.workcell.arm_history import Insertion
from procedures.workcell.tools import MountedTool
from procedures.workcell.workcell import Workcell

__all__ = ["Insertion", "MountedTool", "Workcell"]
