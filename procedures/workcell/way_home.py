"""The way home: where the arm parks, and by which joint angles it came since it left from there."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

from procedures.results.errors import StepRefused
from procedures.workcell.arm_view import stands_at
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.readings import ArmReading, JointVector

TRAIL = 200  # joint angles that are kept to find the way back; a case visits fewer between two homes
AT_HOME_RAD = math.radians(0.1)  # far more than the arm's repeatability, far less than any way


class WayHome:
    """Knows the way, and leads an arm back on it."""

    def __init__(
        self, joints_rad: Callable[[], JointVector], move: Callable[[str, JointVector], ArmReading]
    ) -> None:
        """`joints_rad` measures; `move` is a joint move, by what it is called and where it leads."""
        self._joints_rad = joints_rad
        self._move = move
        self._home_rad: JointVector | None = None
        self._trail: deque[JointVector] = deque(maxlen=TRAIL)

    def take_up(self, home_rad: JointVector, trail: Iterable[JointVector]) -> None:
        """Take for true where home is, and how the arm came from there."""
        self._home_rad = home_rad
        self._trail = deque(trail, maxlen=TRAIL)

    def set_home(self) -> JointVector:
        """Use the arm's present position as home."""
        self._home_rad = self._joints_rad()
        return self._home_rad

    @property
    def home_rad(self) -> JointVector:
        """Raises PRO-001 before there is a home."""
        if self._home_rad is None:
            raise StepRefused("the arm has no home position yet", action="Run set_up first.")
        return self._home_rad

    @property
    def known_rad(self) -> JointVector | None:
        """Where home is, if there is one."""
        return self._home_rad

    @property
    def back_rad(self) -> tuple[JointVector, ...]:
        """Where the arm was since it left home, the last place first."""
        return tuple(reversed(self._trail))

    @property
    def at_home(self) -> bool:
        """Whether the measured joints are those of home."""
        return self._home_rad is not None and stands_at(self._joints_rad(), self._home_rad, AT_HOME_RAD)

    @property
    def away(self) -> bool:
        """Whether the arm has left home and is not back."""
        return bool(self._trail) and not self.at_home

    def came_by(self, joints_rad: JointVector) -> None:
        """Remember where a motion has led."""
        self._trail.append(joints_rad)

    def go(self) -> ArmReading:
        """A joint move home; the way is forgotten."""
        reached = self._move("home", self.home_rad)
        self._trail.clear()
        return reached

    def go_back(self) -> ArmReading:
        """As `go`; where that is not clear, back along the way the arm came."""
        try:
            return self.go()
        except NotClear:  # raised before anything moved
            for joints_rad in self.back_rad:
                self._move("back", joints_rad)
            return self.go()
