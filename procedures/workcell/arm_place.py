"""Place of an arm, the axis that its guide is on, and an instrument that may be inside the head.

The one answer for engine, steps and recovery.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from procedures.journal.results import FramedPose, Values
from procedures.strategies.trajectory import back_along_axis
from procedures.workcell.errors import TipOffAxis
from ronna_hw.evidence.journal_reading import JournalValue
from ronna_hw.frames import Transform

# Nominal tip frame against the axis. A settled arm is within 0.05 mm; ten times that is beyond rounding, and
# still less than what bends a needle.
ON_AXIS_MM = 0.5
ON_AXIS_RAD = math.radians(0.5)
AT_PLACE_RAD = math.radians(0.1)  # far more than the arm's repeatability, far less than any motion


class JournalledAxis(Values):
    """An insertion in the journal."""

    held: FramedPose
    travel_mm: float
    arriving: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Insertion:
    """The line along which a guide may move near the head.

    `held` is the pose ROBOT <- TOOL in which the guide is held, outside the skin; `travel_mm` the distance
    along the axis from the start of the approach, where the retreat ends. `arriving` (+1 or -1) is the
    direction in which each joint arrives there, if known.
    """

    trajectory: str
    held: Transform
    travel_mm: float
    arriving: tuple[int, ...] | None = None

    def as_plain(self) -> dict[str, JournalValue]:
        """Plain values for the journal: all that is needed to find the way out again."""
        axis = JournalledAxis(held=FramedPose.of(self.held), travel_mm=self.travel_mm, arriving=self.arriving)
        return axis.model_dump(mode="json")

    @classmethod
    def from_plain(cls, trajectory: str, axis: object) -> Insertion:
        """Read an insertion back from the journal. Raises ValueError."""
        read = JournalledAxis.model_validate(axis)
        return cls(trajectory, read.held.transform, read.travel_mm, read.arriving)

    @property
    def start(self) -> Transform:
        """The pose on the axis where the approach begins."""
        return back_along_axis(self.held, self.travel_mm)

    def beyond_start_mm(self, tool: Transform) -> float:
        """Distance of a pose ROBOT <- TOOL along the axis; negative before the start of the approach."""
        along_mm = self.start.inverse().apply(tool.translation_mm)[2]
        return float(along_mm)

    def check_on_axis(self, tool: Transform) -> None:
        """Raise PRO-015 unless origin and direction of a pose ROBOT <- TOOL are on the axis."""
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


class Where(StrEnum):
    """Place of an arm according to the journal."""

    HOME = "home"
    AWAY = "away from home"
    ON_AXIS = "on the axis of a trajectory"
    MOVING = "moving"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class ArmPlace:
    """Place of one arm, folded from the journal by `ArmHistory`.

    `axis` is set from the intent to insert the guide to the end of its withdrawal, also during these motions
    and after a kill in one. `instrument_may_be_inside` names a trajectory, the gauge or the divot; `assumed`
    says that no line of the journal put it there.
    """

    where: Where = Where.UNKNOWN
    axis: Insertion | None = None
    withdrawn_from: str | None = None  # the trajectory that the guide left last, if it is on none
    instrument_may_be_inside: str | None = None
    assumed: bool = False
    moved: bool = False  # by a motion of this run

    @property
    def is_home(self) -> bool:
        """Whether the arm is at home."""
        return self.where is Where.HOME

    @property
    def is_out(self) -> bool:
        """Whether the arm may be away from home, by a motion of the run or by measurement."""
        return not self.is_home and (self.moved or self.where is not Where.UNKNOWN)

    @property
    def trajectory(self) -> str | None:
        """Trajectory on whose axis the guide is, or may be."""
        return None if self.axis is None else self.axis.trajectory

    @property
    def on_axis(self) -> bool:
        """Whether the guide is, or may be, on the axis of a trajectory."""
        return self.axis is not None

    @property
    def why_held(self) -> tuple[str, ...]:
        """Reason why only a retreat is possible; empty unless the guide is on an axis."""
        if self.trajectory is None:
            return ()
        return (f"the guide is held in front of the entry of {self.trajectory}",)

    @property
    def instrument_in_words(self) -> str | None:
        """State in words that an instrument is, or may be, inside; None if it is out."""
        if (inside := self.instrument_may_be_inside) is None:
            return None
        return f"an instrument {'may still be' if self.assumed else 'is still'} in {inside}"


def stands_at(
    joints_rad: Sequence[float], place_rad: Sequence[float], within_rad: float = AT_PLACE_RAD
) -> bool:
    """Whether every joint is within a small angle of a place, by default `AT_PLACE_RAD`."""
    return all(abs(here - there) < within_rad for here, there in zip(joints_rad, place_rad, strict=True))
