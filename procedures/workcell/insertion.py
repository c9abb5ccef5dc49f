"""An instrument on its way into the head: the one axis along which it may move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from procedures.engine.result import FramedPose, Values
from procedures.strategies.orientation import back_along_axis
from procedures.workcell.errors import TipOffAxis
from ronna_hw.evidence.journal_reading import JournalValue
from ronna_hw.frames import Transform

# Nominal tip against the axis. A settled arm is within 0.05 mm; ten times that is no rounding any more, and
# still less than what bends a needle.
ON_AXIS_MM = 0.5
ON_AXIS_RAD = math.radians(0.5)


class JournalledAxis(Values):
    """An insertion as the journal has it."""

    target: FramedPose
    depth_mm: float
    standoff_mm: float


@dataclass(frozen=True)
class Insertion:
    """A trajectory as the arm goes it: the pose ROBOT <- TOOL at the target, and how deep that is.

    `standoff_mm` is how far outside the entry the way begins and ends.
    """

    trajectory: str
    target: Transform
    depth_mm: float
    standoff_mm: float

    def as_plain(self) -> dict[str, JournalValue]:
        """For the journal: what is needed to find the way out again."""
        axis = JournalledAxis(
            target=FramedPose.of(self.target), depth_mm=self.depth_mm, standoff_mm=self.standoff_mm
        )
        return axis.model_dump(mode="json")

    @classmethod
    def from_plain(cls, trajectory: str, axis: object) -> Insertion:
        """Back from the journal; raises ValueError."""
        read = JournalledAxis.model_validate(axis)
        return cls(trajectory, read.target.transform, read.depth_mm, read.standoff_mm)

    @property
    def standoff(self) -> Transform:
        """The pose on the axis outside the entry."""
        return back_along_axis(self.target, self.travel_mm)

    @property
    def travel_mm(self) -> float:
        """From the stand-off to the target."""
        return self.depth_mm + self.standoff_mm

    def beyond_standoff_mm(self, tool: Transform) -> float:
        """How far along the axis the tip of a pose ROBOT <- TOOL is; negative before the stand-off."""
        along_mm = self.standoff.inverse().apply(tool.translation_mm)[2]
        return float(along_mm)

    def check_on_axis(self, tool: Transform) -> None:
        """Raise PRO-015 unless a pose ROBOT <- TOOL has its tip and its direction on the axis."""
        tip_mm = self.target.inverse().apply(tool.translation_mm)
        off_mm = float(np.hypot(tip_mm[0], tip_mm[1]))
        cosine = float(tool.rotation_matrix[:, 2] @ self.target.rotation_matrix[:, 2])
        turned_rad = math.acos(min(1.0, max(-1.0, cosine)))
        if off_mm > ON_AXIS_MM or turned_rad > ON_AXIS_RAD:
            raise TipOffAxis(
                f"the tip is not on the axis of {self.trajectory}",
                limit=f"{ON_AXIS_MM:g} mm, {math.degrees(ON_AXIS_RAD):g} deg",
                got=f"{off_mm:.2f} mm, {math.degrees(turned_rad):.2f} deg",
            )
