"""A motion of the workcell as a value: what the operator confirms is what the arm then drives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from procedures.workcell.insertion import Insertion
from ronna_hw.devices import Motion, RobotArm
from ronna_hw.devices.readings import ArmReading


class MotionName(StrEnum):
    """A kind of motion, as the journal calls it."""

    START = "start"  # of the arm, confirmed: a controller that is not verified is tested by a micro-move
    GO = "go"
    HOME = "home"
    BACK = "back"
    STEP = "step"
    SETTLE = "settle"
    LINE = "line"
    INSERT = "insert"
    WITHDRAW = "withdraw"


@dataclass(frozen=True)
class CellMotion:
    """What the arm drives in turn, from wherever it is; all but the last are joint moves.

    If the first is not clear, `otherwise` comes in place of all, if there is any: the workcell then drives it
    as motions of their own, so that the journal has the way the arm came.
    """

    what: MotionName
    moves: str  # such as `the guide`
    to: tuple[float, ...]  # joints in rad, or the tool's position in mm
    legs: tuple[Motion, ...]
    otherwise: tuple[Motion, ...] = ()
    detour: str = "via home"  # what `otherwise` is
    axis: Insertion | None = None  # along which it goes

    @property
    def trajectory(self) -> str | None:
        """The trajectory along whose axis it goes."""
        return None if self.axis is None else self.axis.trajectory

    def drive(self, arm: RobotArm) -> ArmReading:
        """Carry it out; the last reading. Raises what the motions of the arm raise."""
        return [leg.drive(arm) for leg in self.legs][-1]
