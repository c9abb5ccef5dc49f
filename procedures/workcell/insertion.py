"""A guide on the axis of a trajectory: the one line along which it may move while it is near the head."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from procedures.journal.results import FramedPose, Values
from procedures.strategies.orientation import back_along_axis
from procedures.workcell.errors import TipOffAxis
from ronna_hw.evidence.journal_reading import JournalValue
from ronna_hw.frames import Transform

# Nominal tip frame against the axis. A settled arm is within 0.05 mm; ten times that is no rounding any more,
# and still less than what bends a needle.
ON_AXIS_MM = 0.5
ON_AXIS_RAD = math.radians(0.5)


class JournalledAxis(Values):
    """An insertion as the journal has it."""

    held: FramedPose
    travel_mm: float
    arriving: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Insertion:
    """A trajectory as the arm goes it: the pose ROBOT <- TOOL where the guide is held, outside the skin.

    `travel_mm` is the way along the axis from where the approach begins, and where the retreat ends.
    `arriving`, +1 or -1, says in which direction each joint arrives there, where that is known.
    """

    trajectory: str
    held: Transform
    travel_mm: float
    arriving: tuple[int, ...] | None = None

    def as_plain(self) -> dict[str, JournalValue]:
        """For the journal: what is needed to find the way out again."""
        axis = JournalledAxis(held=FramedPose.of(self.held), travel_mm=self.travel_mm, arriving=self.arriving)
        return axis.model_dump(mode="json")

    @classmethod
    def from_plain(cls, trajectory: str, axis: object) -> Insertion:
        """Back from the journal; raises ValueError."""
        read = JournalledAxis.model_validate(axis)
        return cls(trajectory, read.held.transform, read.travel_mm, read.arriving)

    @property
    def start(self) -> Transform:
        """The pose on the axis where the approach begins."""
        return back_along_axis(self.held, self.travel_mm)

    def beyond_start_mm(self, tool: Transform) -> float:
        """How far along the axis a pose ROBOT <- TOOL is; negative before the approach begins."""
        along_mm = self.start.inverse().apply(tool.translation_mm)[2]
        return float(along_mm)

    def check_on_axis(self, tool: Transform) -> None:
        """Raise PRO-015 unless a pose ROBOT <- TOOL has its origin and its direction on the axis."""
        tip_mm = self.held.inverse().apply(tool.translation_mm)
        off_mm = float(np.hypot(tip_mm[0], tip_mm[1]))
        cosine = float(tool.rotation_matrix[:, 2] @ self.held.rotation_matrix[:, 2])
        turned_rad = math.acos(min(1.0, max(-1.0, cosine)))
        if off_mm > ON_AXIS_MM or turned_rad > ON_AXIS_RAD:
            raise TipOffAxis(
                f"the guide is not on the axis of {self.trajectory}",
                limit=f"{ON_AXIS_MM:g} mm, {math.degrees(ON_AXIS_RAD):g} deg",
                got=f"{off_mm:.2f} mm, {math.degrees(turned_rad):.2f} deg",
            )
