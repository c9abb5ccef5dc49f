"""$TOOL_DATA and $BASE_DATA: the frames defined by programs, by number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.kuka.arm.manipulator import Manipulator
from sim.world.nominal_arm import pose_of_frame

Matrix = NDArray[np.float64]


class FrameTable:
    """Tools in the flange frame and bases in $ROBROOT, (4, 4); number 0 is the flange, or $ROBROOT."""

    def __init__(self, arm: Manipulator) -> None:
        self._arm = arm
        self._tools: dict[int, Matrix] = {0: np.eye(4)}
        self._bases: dict[int, Matrix] = {0: np.eye(4)}
        self.tool_number = 0
        self.base_number = 0

    def set_tool(self, number: int, frame: Sequence[float]) -> None:
        """Define a tool and use it; X Y Z (mm) A B C (deg)."""
        self._tools[number] = pose_of_frame(frame)
        self.use(number, self.base_number)

    def set_base(self, number: int, frame: Sequence[float]) -> None:
        """Define a base and use it; X Y Z (mm) A B C (deg)."""
        self._bases[number] = pose_of_frame(frame)
        self.use(self.tool_number, number)

    def use(self, tool_number: int, base_number: int) -> None:
        """Activate a tool and a base; ValueError for a number that was never defined."""
        if tool_number not in self._tools:
            raise ValueError(f"tool {tool_number} is not defined")
        if base_number not in self._bases:
            raise ValueError(f"base {base_number} is not defined")
        self._arm.set_tool(self._tools[tool_number])
        self._arm.set_base(self._bases[base_number])
        self.tool_number, self.base_number = tool_number, base_number
