"""The history of an arm and of the hands at it: where it is, the way it came, the work through the guide.

It is folded from the lines of the journal, one after the other: while the case runs by `ArmLog`, after it
from the file. So a resumed case knows what the running one knew.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import cast

from procedures.journal.journal import Entry, JournalValue, Line
from procedures.workcell.arm_place import ArmPlace, Where
from procedures.workcell.arm_view import stands_at
from procedures.workcell.cell_motion import MotionName
from procedures.workcell.insertion import Insertion
from ronna_hw.config import MASTER
from ronna_hw.devices.readings import JointVector
from ronna_hw.evidence.journal_reading import Chain, JournalCorrupt

# Joint angles that are kept to find the way back: without the first ones it could end where the way home is
# not clear. A localized sphere adds six or seven, many more if it is searched for: 3 trajectories with 5
# spheres each made 92 between two homes, so 4 with 8 come near 200 without any search.
TRAIL = 2000
Stages = Mapping[str, Mapping[str, bool]]  # trajectory -> task -> whether it was confirmed to be done
Stop = Mapping[str, JournalValue]  # how a depth stop was set


@dataclass(frozen=True)
class ArmHistory:
    """The history of one arm; `trail` is where it was since it left home.

    A guide counts as on its axis from the intent to approach along it to the end of its withdrawal, an
    instrument as inside from before it goes in until it was confirmed to be out. After a kill an instrument
    may be inside a guide on an axis unless it was confirmed to be out in the lines that are left.
    """

    arm: str = MASTER
    place: ArmPlace = field(default_factory=ArmPlace)
    trail: tuple[JointVector, ...] = ()
    motions: int = 0  # begun
    journeys: int = 0  # of these, the ones that led the arm anywhere, or may have
    under_way: str | None = None  # the motion whose end is not recorded yet
    instrument_out: bool = False  # confirmed since the guide was brought to its axis last
    stages: Stages = field(default_factory=dict)  # of the work through the guide
    stops: Mapping[str, Stop] = field(default_factory=dict)  # of the instrument, by trajectory

    def after(self, line: Line) -> ArmHistory:
        """With one more line; raises LookupError, TypeError or ValueError for one that is not ours."""
        entry = line["entry"]
        if entry == Entry.RESTARTED:
            return self.after_restart(torn=bool(line.get("torn_bytes")))
        if line.get("arm", MASTER) != self.arm:
            return self
        match entry:
            case Entry.MOTION:
                return self._after_intent(line)
            case Entry.MOVED:
                return self._after_arrival(line)
            case Entry.PLACED:
                return self._after_look(line)
            case Entry.INSTRUMENT:
                inside = str(line["trajectory"]) if line["inside"] else None
                place = replace(
                    self.place, instrument_may_be_inside=inside, assumed=line.get("assumed") is True
                )
                return replace(self, place=place, instrument_out=inside is None)
            case Entry.STAGE:
                return self._after_stage(line)
            case _:
                return self

    def after_restart(self, *, torn: bool) -> ArmHistory:
        """The history that the next program must assume; `torn` if the last lines may be lost."""
        place = self.place
        if torn or place.where is Where.MOVING:
            place = replace(place, where=Where.UNKNOWN, moved=True)
        # The line saying that an instrument goes in follows that of the guide, and can be lost alone.
        if place.trajectory not in (None, place.instrument_may_be_inside) and (
            torn or not self.instrument_out
        ):
            place = replace(place, instrument_may_be_inside=place.trajectory, assumed=True)
        return replace(self, place=place, under_way=None, instrument_out=self.instrument_out and not torn)

    def _after_intent(self, line: Line) -> ArmHistory:
        what = str(line.get("what"))
        begun = replace(
            self,
            place=replace(self.place, where=Where.MOVING, moved=True),
            motions=self.motions + 1,
            journeys=self.journeys + 1,
            under_way=what,
        )
        if what != MotionName.INSERT:
            return begun
        axis = Insertion.from_plain(str(line["trajectory"]), line["axis"])
        return replace(
            begun, place=replace(begun.place, axis=axis, withdrawn_from=None), instrument_out=False
        )

    def _after_arrival(self, line: Line) -> ArmHistory:
        arrived = "joints_rad" in line
        joints_rad, ended = _joints_rad(line) if arrived else None, self.under_way
        place, trail, journeys = self.place, self.trail, self.journeys
        if arrived and ended == MotionName.WITHDRAW and place.axis is not None:
            place = replace(place, axis=None, withdrawn_from=place.axis.trajectory)
        refused = not arrived and line.get("at_home") is True and place.axis is None  # before it began
        if refused or (arrived and ended == MotionName.START):
            journeys -= 1
        if joints_rad is not None and ended == MotionName.BACK:
            trail = self._trail_to(joints_rad)
        elif joints_rad is not None and ended not in (MotionName.START, MotionName.INSERT):
            trail = (*trail, joints_rad)[-TRAIL:]
        moved = replace(self, place=replace(place, moved=journeys > 0), journeys=journeys, under_way=None)
        return replace(moved, trail=trail)._resting(line.get("at_home"))

    def _after_look(self, line: Line) -> ArmHistory:
        """The measured joints decide, whatever led the arm there."""
        if (axis := line.get("axis")) is not None:
            found = Insertion.from_plain(str(line["trajectory"]), axis)
            place = replace(
                self.place,
                axis=found,
                withdrawn_from=None,
                instrument_may_be_inside=found.trajectory,
                assumed=True,
            )
            return replace(self, place=place, instrument_out=False)._resting(False)
        if line["at_home"] is True:  # jogged off its axis, if it was on one
            return replace(self, place=replace(self.place, axis=None))._resting(True)
        return self._resting(False)

    def _resting(self, at_home: object) -> ArmHistory:
        """Where the arm came to rest; `at_home` is None where that was not measured."""
        if self.place.axis is not None:
            return replace(self, place=replace(self.place, where=Where.ON_AXIS))
        where = Where.UNKNOWN if at_home is None else Where.HOME if at_home is True else Where.AWAY
        trail = () if where is Where.HOME else self.trail
        return replace(self, place=replace(self.place, where=where), trail=trail)

    def _trail_to(self, joints_rad: JointVector) -> tuple[JointVector, ...]:
        """The trail up to a place on it: the arm went back there, and what lies beyond is behind it."""
        for number in range(len(self.trail), 0, -1):
            if stands_at(joints_rad, self.trail[number - 1]):
                return self.trail[:number]
        return self.trail

    def _after_stage(self, line: Line) -> ArmHistory:
        trajectory, stop = str(line["trajectory"]), line.get("stop")
        if isinstance(stop, Mapping):
            return replace(self, stops={**self.stops, trajectory: stop})
        tasks = {**self.stages.get(trajectory, {}), str(line["task"]): bool(line["done"])}
        return replace(self, stages={**self.stages, trajectory: tasks})


UNMOVED = ArmHistory()


def arm_history(lines: Iterable[Line], arm: str = MASTER) -> ArmHistory:
    """Fold a journal into the history of one arm; raises PRO-011 for a line that this version cannot read."""
    return reduce(_followed_by, lines, UNMOVED if arm == MASTER else ArmHistory(arm))


def history_left_by(chain: Chain, arm: str = MASTER) -> ArmHistory:
    """The history of an arm after the program that moved it has ended; raises as `arm_history`."""
    return arm_history(chain.lines, arm).after_restart(torn=bool(chain.torn))


def _joints_rad(line: Line) -> JointVector:
    return cast("JointVector", tuple(cast("list[float]", line["joints_rad"])))


def _followed_by(history: ArmHistory, line: Line) -> ArmHistory:
    try:
        return history.after(line)
    except (LookupError, TypeError, ValueError) as error:
        raise JournalCorrupt(
            f"line {line.get('sequence')}, {line.get('entry')}, is not as this version writes it"
        ) from error
