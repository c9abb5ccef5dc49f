"""What the arm and the hands at it have done: the way it came, the guide on its axis, the instrument.

It is folded from the lines of the journal, one after the other: while the case runs by `ArmLog`, after it
from the file. So a resumed case knows what the running one knew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import cast

from procedures.journal.journal import Entry, JournalValue, Line
from procedures.workcell.arm_view import stands_at
from procedures.workcell.cell_motion import MotionName
from procedures.workcell.insertion import Insertion
from ronna_hw.devices.readings import JointVector
from ronna_hw.evidence.errors import JournalCorrupt

# Joint angles that are kept to find the way back: without the first ones it could end where the way home is
# not clear. A localized sphere adds six or seven, many more if it is searched for: 3 trajectories with 5
# spheres each made 92 between two homes, so 4 with 8 come near 200 without any search.
TRAIL = 2000
AT_PLACE_RAD = math.radians(0.1)  # far more than the arm's repeatability
Stages = Mapping[str, Mapping[str, bool]]  # trajectory -> task -> whether it was confirmed to be done
Stop = Mapping[str, JournalValue]  # how a depth stop was set


@dataclass(frozen=True)
class ArmHistory:
    """`trail` is where the arm was since it left home, `motions` how many it made.

    A guide counts as on its axis from the intent to approach along it to the end of its withdrawal, an
    instrument as inside from before it goes in until it was confirmed to be out.
    """

    trail: tuple[JointVector, ...] = ()
    insertion: Insertion | None = None
    withdrawn_from: str | None = None  # the trajectory from which the guide came last, if it is on none
    motions: int = 0
    unfinished: str | None = None  # the last motion, if its end is not recorded: the arm may be on its way
    instrument_in: str | None = None  # the trajectory, or the gauge
    instrument_out: bool = False  # confirmed since the guide was brought there last
    stages: Stages = field(default_factory=dict)  # of the work through the guide
    stops: Mapping[str, Stop] = field(default_factory=dict)  # of the instrument, by trajectory

    @property
    def left_home(self) -> bool:
        """Whether the arm was led away from home, as far as is recorded, and not back to it."""
        return self.insertion is not None or bool(self.trail) or self.unfinished is not None

    def with_hands_of(self, other: ArmHistory) -> ArmHistory:
        """With what the hands at the guide did in another history; where the arm is stays."""
        return replace(
            self,
            instrument_in=other.instrument_in,
            instrument_out=other.instrument_out,
            stages=other.stages,
            stops=other.stops,
        )

    def after(self, line: Line) -> ArmHistory:
        """With one more line; raises LookupError, TypeError or ValueError for one that is not ours."""
        match line["entry"]:
            case Entry.MOTION:
                return self._after_intent(line)
            case Entry.MOVED if "joints_rad" in line:
                joints_rad = cast("JointVector", tuple(cast("list[float]", line["joints_rad"])))
                return replace(self._after_arrival(joints_rad), unfinished=None)
            case Entry.MOVED if line.get("at_home") is True and self.insertion is None:
                return replace(self, trail=(), unfinished=None)
            case Entry.INSTRUMENT:
                inside = str(line["trajectory"]) if line["inside"] else None
                return replace(self, instrument_in=inside, instrument_out=inside is None)
            case Entry.RESTARTED if line.get("torn_bytes"):  # the lost lines may have put an instrument in
                return replace(self, instrument_out=False)
            case Entry.STAGE:
                return self._after_stage(line)
            case _:
                return self

    def _after_intent(self, line: Line) -> ArmHistory:
        begun = replace(self, motions=self.motions + 1, unfinished=str(line.get("what")))
        if begun.unfinished != MotionName.INSERT:
            return begun
        return replace(
            begun,
            insertion=Insertion.from_plain(str(line["trajectory"]), line["axis"]),
            withdrawn_from=None,
            instrument_out=False,
        )

    def _after_arrival(self, joints_rad: JointVector) -> ArmHistory:
        if self.unfinished == MotionName.HOME:
            return replace(self, trail=())
        if self.unfinished in (MotionName.START, MotionName.INSERT):
            return self
        if self.unfinished == MotionName.WITHDRAW and self.insertion is not None:
            return replace(self, insertion=None, withdrawn_from=self.insertion.trajectory)
        if self.unfinished == MotionName.BACK:
            return replace(self, trail=self._trail_to(joints_rad))
        return replace(self, trail=(*self.trail, joints_rad)[-TRAIL:])

    def _trail_to(self, joints_rad: JointVector) -> tuple[JointVector, ...]:
        """The trail up to a place on it: the arm went back there, and what lies beyond is behind it."""
        for number in range(len(self.trail), 0, -1):
            if stands_at(joints_rad, self.trail[number - 1], AT_PLACE_RAD):
                return self.trail[:number]
        return self.trail

    def _after_stage(self, line: Line) -> ArmHistory:
        trajectory, stop = str(line["trajectory"]), line.get("stop")
        if isinstance(stop, Mapping):
            return replace(self, stops={**self.stops, trajectory: stop})
        tasks = {**self.stages.get(trajectory, {}), str(line["task"]): bool(line["done"])}
        return replace(self, stages={**self.stages, trajectory: tasks})


UNMOVED = ArmHistory()


def arm_history(lines: Iterable[Line]) -> ArmHistory:
    """Of a run, from its journal; raises PRO-011 for a line that is not as this version writes it."""
    return reduce(_followed_by, lines, UNMOVED)


def _followed_by(history: ArmHistory, line: Line) -> ArmHistory:
    try:
        return history.after(line)
    except (LookupError, TypeError, ValueError) as error:
        raise JournalCorrupt(
            f"line {line.get('sequence')}, {line.get('entry')}, is not as this version writes it"
        ) from error
