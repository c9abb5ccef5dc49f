"""The way home: where the arm parks, and by which joint angles it came since it left from there."""

from __future__ import annotations

from collections.abc import Callable

from procedures.journal.errors import StepRefused
from procedures.workcell.arm_view import stands_at
from procedures.workcell.cell_motion import CellMotion, MotionName
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.readings import ArmReading, JointVector


class WayHome:
    """Knows the way, and leads an arm back on it, or past what stands in its way."""

    def __init__(
        self,
        joints_rad: Callable[[], JointVector],
        trail: Callable[[], tuple[JointVector, ...]],
        move: Callable[[MotionName, JointVector], ArmReading],
    ) -> None:
        """`joints_rad` measures; `trail` is where the arm was since it left home; `move` is a joint move."""
        self._joints_rad = joints_rad
        self._move = move
        self._home_rad: JointVector | None = None
        self._trail = trail
        self.settled = False  # whether every joint came home from the same side as ever

    def take_up(self, home_rad: JointVector) -> None:
        """Restore where home was."""
        self._home_rad = home_rad

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
        return tuple(reversed(self._trail()))

    def is_home(self, joints_rad: JointVector) -> bool | None:
        """Whether these joints are those of home; None before there is one."""
        return None if self._home_rad is None else stands_at(joints_rad, self._home_rad)

    def go(self) -> ArmReading:
        """A joint move home, each joint arriving from the same side: small changes then show there."""
        self.settled = False
        reached = self._move(MotionName.HOME, self.home_rad)
        self.settled = True
        return reached

    def past(self, motion: CellMotion, carry_out: Callable[[CellMotion], ArmReading]) -> ArmReading:
        """Carry a motion out; where it is not clear, again from home if it may go by there."""
        try:
            return carry_out(motion)
        except NotClear:
            if not motion.otherwise:
                raise
            self.go()
            return carry_out(motion)

    def go_back(self) -> ArmReading:
        """As `go`; where that is not clear, back along the way the arm came."""
        try:
            return self.go()
        except NotClear:
            for joints_rad in self.back_rad:
                self._move(MotionName.BACK, joints_rad)
            return self.go()
