"""The only way in which procedures look and move: arm, mounted tool, surroundings, stereo head, tracker."""

from procedures.workcell.insertion import Insertion
from procedures.workcell.workcell import MountedTool, Workcell

__all__ = ["Insertion", "MountedTool", "Workcell"]
