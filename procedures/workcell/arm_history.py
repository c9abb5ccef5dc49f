"""History of an arm and the work through its guide: its place, the path it took, the stages of work.

With it, where the tracker that watches it has been moved to.

Folded line by line from the journal: by `ArmLog` while the case runs, afterwards from the file. A resumed
case therefore knows what the running one knew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import reduce
from typing import Any, cast

import numpy as np

from procedures.journal.journal import Entry, Journal, JournalValue, Line
from procedures.journal.results import FramedPose, Values
from procedures.room.sighting import Sighting
from procedures.strategies.trajectory import back_along_axis
from procedures.workcell.errors import TipOffAxis
from procedures.workcell.tracker_move import TrackerMove
from ronna_hw.clock import Clock
from ronna_hw.evidence.journal_reading import JournalChain, JournalCorrupt
from ronna_hw.evidence.lost_journal_end import LOST, lost_as_plain
from ronna_hw.frames import Transform
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.vectors import JointVector

# Nominal tip frame against the axis. A settled arm is within 0.05 mm; ten times that is beyond rounding, and
# still less than what bends a needle.
# Safety against an instrument that is moved while off its axis (U).
ON_AXIS_MM = 0.5
ON_AXIS_RAD = math.radians(0.5)
# Safety against an arm that is not where the journal has it (U).
AT_PLACE_RAD = math.radians(0.1)  # far more than the arm's repeatability, far less than any motion
# Places kept for the way back; without the first ones it could end where the way home is not clear. A
# localized sphere adds three or more, many more if it is searched for: 4 trajectories with 8 spheres each
# come near 200 where every sphere is approached along its axis.
TRAIL = 2000
Stages = Mapping[str, Mapping[str, bool]]  # trajectory -> task -> whether it was confirmed as done
Stop = Mapping[str, JournalValue]  # setting of a depth stop
Opening = Mapping[str, JournalValue]  # as an assistant drilled it


class JournalledAxis(Values):
    """Insertion axis as recorded in the journal."""

    held: FramedPose
    travel_mm: float
    arriving: tuple[int, ...] | None = None


@dataclass(frozen=True)
class InsertionAxis:
    """Axis along which a guide may move near the head.

    `held` is the pose ROBOT <- TOOL (of an assistant: ASSISTANT <- TOOL) in which the guide is held, outside
    the skin. `travel_mm` is its distance along the axis from the start of the approach, where the retreat
    ends. `arriving` (+1 or -1; 0 unknown) is the direction in which each joint arrives there, if known.
    """

    trajectory: str
    held: Transform
    travel_mm: float
    arriving: tuple[int, ...] | None = None

    def as_plain(self) -> dict[str, JournalValue]:
        """Return plain values for the journal, sufficient for a later retreat."""
        axis = JournalledAxis(held=FramedPose.of(self.held), travel_mm=self.travel_mm, arriving=self.arriving)
        return axis.model_dump(mode="json")

    @classmethod
    def from_plain(cls, trajectory: str, axis: object) -> InsertionAxis:
        """Read an insertion back from the journal. Raises ValueError if it is malformed."""
        read = JournalledAxis.model_validate(axis)
        return cls(trajectory, read.held.transform, read.travel_mm, read.arriving)

    @property
    def start(self) -> Transform:
        """Pose ROBOT <- TOOL on the axis where the approach begins."""
        return self.pose_at(0.0)

    def pose_at(self, travel_mm: float) -> Transform:
        """Return the pose ROBOT <- TOOL on the axis at this distance from the start of the approach."""
        return back_along_axis(self.held, self.travel_mm - travel_mm)

    def travel_from_start_mm(self, tool: Transform) -> float:
        """Return how far (mm) a pose ROBOT <- TOOL is along the axis; negative before the approach."""
        along_mm = self.start.inverse().apply(tool.translation_mm)[2]
        return float(along_mm)

    def check_on_axis(self, tool: Transform, named: str = "the guide") -> None:
        """Raise PRO-015 unless the position and direction of a pose ROBOT <- TOOL are on the axis."""
        tip_mm = self.held.inverse().apply(tool.translation_mm)
        off_mm = float(np.hypot(tip_mm[0], tip_mm[1]))
        cosine = float(tool.rotation_matrix[:, 2] @ self.held.rotation_matrix[:, 2])
        turned_rad = math.acos(min(1.0, max(-1.0, cosine)))
        if off_mm > ON_AXIS_MM or turned_rad > ON_AXIS_RAD:
            raise TipOffAxis(
                f"{named} is not on the axis of {self.trajectory}",
                limit=f"{ON_AXIS_MM:g} mm, {math.degrees(ON_AXIS_RAD):g} deg",
                got=f"{off_mm:.2f} mm, {math.degrees(turned_rad):.2f} deg",
            )


class HeldDrill(Values):
    """State of a drill in the assistant's holder, as recorded in the journal.

    Its tip is at the entry with the clamp `entry_mm` from the start of its axis; it was last switched off
    with the tip `reached_mm` behind the entry.
    """

    entry_mm: float
    may_turn: bool = False
    reached_mm: float | None = None


@dataclass(frozen=True)
class HeldInstrument:
    """Instrument that is, or may be, in the assistant's holder.

    Its tip is `tip_mm` beyond the clamp; `at_bore` are the parts of the guide that it may come close to.
    """

    trajectory: str
    tip_mm: float
    at_bore: tuple[str, ...]
    drill: HeldDrill | None = None  # of one that is a drill

    @property
    def name(self) -> str:
        return "instrument" if self.drill is None else "drill"

    @property
    def may_turn(self) -> bool:
        """Whether the drill, if it is one, may still be switched on."""
        return self.drill is not None and self.drill.may_turn

    @property
    def description(self) -> str:
        """Statement that it is in the holder."""
        turning = " and MAY BE TURNING: drilling was begun there" if self.may_turn else ""
        return f"the {self.name} for {self.trajectory} is in the assistant's holder{turning}"


class MotionKind(StrEnum):
    """Kind of motion, as recorded in the journal."""

    START = "start"  # a confirmed start: an unverified controller is tested by a micro-move
    GO = "go"
    HOME = "home"
    BACK = "back"
    STEP = "step"
    SETTLE = "settle"
    LINE = "line"
    INSERT = "insert"
    WITHDRAW = "withdraw"


class PlaceKind(StrEnum):
    """Place of an arm according to the journal."""

    HOME = "home"
    AWAY = "away from home"
    ON_AXIS = "on the axis of a trajectory"
    MOVING = "moving"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class ArmPlace:
    """Place of one arm, derived from the journal by `ArmHistory`.

    `axis` is set from the intent to insert the guide to the end of its withdrawal. That includes these
    motions and a kill in one. `instrument_may_be_inside` names a trajectory, the gauge or the divot;
    `assumed` says that no line of the journal put it there.
    """

    place_kind: PlaceKind = PlaceKind.UNKNOWN
    axis: InsertionAxis | None = None
    withdrawn_from: str | None = None  # the trajectory that the guide left last, if it is on none
    instrument_may_be_inside: str | None = None
    assumed: bool = False
    moved: bool = False  # by a motion of this run

    @property
    def is_home(self) -> bool:
        return self.place_kind is PlaceKind.HOME

    @property
    def is_out(self) -> bool:
        """Whether the arm may be away from home, according to this run's motions or a measurement."""
        return not self.is_home and (self.moved or self.place_kind is not PlaceKind.UNKNOWN)

    @property
    def trajectory(self) -> str | None:
        """Trajectory whose axis the guide is on or may be on, if any."""
        return None if self.axis is None else self.axis.trajectory

    @property
    def is_on_axis(self) -> bool:
        """Whether the guide is, or may be, on the axis of a trajectory."""
        return self.axis is not None

    @property
    def description(self) -> str:
        """Place of the arm by the journal, to complete "the arm is"."""
        match self.place_kind:
            case PlaceKind.HOME:
                return "at home"
            case PlaceKind.ON_AXIS:
                return f"on the axis of {self.trajectory}"
            case PlaceKind.UNKNOWN if not self.moved:
                return "where it was before: this run has not moved it"
            case PlaceKind.UNKNOWN:
                near = "" if self.trajectory is None else f", maybe on the axis of {self.trajectory}"
                return f"at no known place{near}: its last motion or the end of the journal was cut short"
            case _:
                return str(self.place_kind)

    @property
    def hold_reasons(self) -> tuple[str, ...]:
        """Reasons why only a retreat is possible; empty unless the guide is on an axis."""
        if self.trajectory is None:
            return ()
        return (f"the guide is held in front of the entry of {self.trajectory}",)

    @property
    def instrument_description(self) -> str | None:
        """Statement that an instrument is or may be inside; None if it is out."""
        if (inside := self.instrument_may_be_inside) is None:
            return None
        return f"an instrument {'may still be' if self.assumed else 'is still'} in {inside}"


def stands_at(
    joints_rad: Sequence[float], place_rad: Sequence[float], within_rad: float = AT_PLACE_RAD
) -> bool:
    """Return whether every joint is within `within_rad` of a place."""
    return all(abs(here - there) < within_rad for here, there in zip(joints_rad, place_rad, strict=True))


@dataclass(frozen=True)
class ArmHistory:
    """History of one arm. `trail` lists the joint positions it has passed since leaving home.

    A guide is on its axis from the intent to approach along it to the end of its withdrawal. An instrument is
    inside from before it goes in until it is confirmed to be out. After a kill, one may be inside a guide
    that is on an axis, unless the surviving lines confirm that it is out.
    """

    arm: str = MASTER
    place: ArmPlace = field(default_factory=ArmPlace)
    trail: tuple[JointVector, ...] = ()
    motions: int = 0  # begun
    journeys: int = 0  # of these, those that moved the arm elsewhere, or may have
    under_way: str | None = None  # the motion without a result yet
    instrument_out: bool = False  # confirmed since the guide was last brought to its axis
    stages: Stages = field(default_factory=dict)  # of the work through the guide
    doubted: frozenset[str] = frozenset()  # trajectories where more may have been done than the journal says
    stops: Mapping[str, Stop] = field(default_factory=dict)  # of the instrument, by trajectory
    openings: Mapping[str, Opening] = field(default_factory=dict)  # drilled by an assistant, by trajectory
    interruptions: Mapping[str, str] = field(default_factory=dict)  # of a stage not done since, by trajectory
    tracker: tuple[str, TrackerMove] | None = None  # since that localization, if it was moved and followed
    looks: tuple[str, tuple[Sighting, ...]] | None = None  # at the room, since that localization
    scanned: tuple[str, tuple[Line, ...]] | None = None  # looks at the skin of a scan that is not whole
    base: Transform | None = None  # ROBOT <- base, of an assistant, once it is known
    base_uncertain_mm: float = 0.0  # by which its arm may be elsewhere
    held: HeldInstrument | None = None  # by an assistant
    drilled: Mapping[str, float] = field(default_factory=dict)  # mm behind the entry, by trajectory

    def with_line(self, line: Line) -> ArmHistory:
        """Apply one journal line. Raises LookupError, TypeError or ValueError if it is malformed."""
        entry = line["entry"]
        if entry == Entry.RESTARTED:
            lost = line.get(LOST)
            work = cast("Sequence[Line]", lost["work"]) if isinstance(lost, Mapping) else ()
            return self.with_restart(torn=bool(line.get("torn_bytes")) or lost is not None, lost=work)
        if line.get("arm", MASTER) != self.arm:
            return self
        match entry:
            case Entry.MOTION:
                return self._with_intent(line)
            case Entry.MOVED:
                return self._with_arrival(line)
            case Entry.PLACED:
                return self._with_look(line)
            case Entry.BASE:
                base = FramedPose.model_validate(line["robot_from_base"])
                uncertain_mm = cast("float", line.get("uncertain_mm", 0.0))
                return replace(self, base=base.transform, base_uncertain_mm=uncertain_mm)
            case Entry.INSTRUMENT:
                inside = str(line["trajectory"]) if line["inside"] else None
                place = replace(
                    self.place, instrument_may_be_inside=inside, assumed=line.get("assumed") is True
                )
                return replace(self, place=place, instrument_out=inside is None)
            case Entry.HELD:
                return self._with_held(line)
            case Entry.STAGE:
                return self._with_stage(line)
            case Entry.TRACKER:
                return replace(self, tracker=TrackerMove.from_plain(line))
            case Entry.LOOK:
                return self._with_sighting(line)
            case Entry.SCANNED:
                return self._with_scanned_look(line)
            case _:
                return self

    def _with_held(self, line: Line) -> ArmHistory:
        if not line["held"]:
            return replace(self, held=None)
        held = _held(line)
        if held.drill is None or held.drill.reached_mm is None:
            return replace(self, held=held)
        deepest_mm = max(held.drill.reached_mm, self.drilled.get(held.trajectory, 0.0))
        return replace(self, held=held, drilled={**self.drilled, held.trajectory: deepest_mm})

    def _with_sighting(self, line: Line) -> ArmHistory:
        localization, look = (
            str(line["localization"]),
            Sighting.from_plain(cast("Mapping[str, Any]", line["look"])),
        )
        known = self.looks[1] if self.looks is not None and self.looks[0] == localization else ()
        return replace(self, looks=(localization, (*known, look)))

    def _with_scanned_look(self, line: Line) -> ArmHistory:
        if (look := line["look"]) is None:
            return replace(self, scanned=None)
        paths = str(line["paths"])
        known = self.scanned[1] if self.scanned is not None and self.scanned[0] == paths else ()
        return replace(self, scanned=(paths, (*known, cast("Line", look))))

    def with_restart(self, *, torn: bool, lost: Sequence[Line] = ()) -> ArmHistory:
        """Apply the end of a program. `torn` means that its last journal lines may be lost.

        `lost` are lines about the work that the journal has lost: more may have been done than they say.
        """
        if lost:
            known = reduce(ArmHistory.with_line, lost, self)
            places = {str(line["trajectory"]) for line in lost if line["entry"] == Entry.STAGE}
            return replace(known, doubted=known.doubted | places).with_restart(torn=True)
        place = self.place
        if torn or place.place_kind is PlaceKind.MOVING:
            place = replace(place, place_kind=PlaceKind.UNKNOWN, moved=True)
        # The line saying that an instrument goes in follows that of the guide, and can be lost alone.
        if place.trajectory not in (None, place.instrument_may_be_inside) and (
            torn or not self.instrument_out
        ):
            place = replace(place, instrument_may_be_inside=place.trajectory, assumed=True)
        return replace(self, place=place, under_way=None, instrument_out=self.instrument_out and not torn)

    def _with_intent(self, line: Line) -> ArmHistory:
        what = str(line.get("what"))
        begun = replace(
            self,
            place=replace(self.place, place_kind=PlaceKind.MOVING, moved=True),
            motions=self.motions + 1,
            journeys=self.journeys + 1,
            under_way=what,
        )
        if what != MotionKind.INSERT:
            return begun
        axis = InsertionAxis.from_plain(str(line["trajectory"]), line["axis"])
        return replace(
            begun, place=replace(begun.place, axis=axis, withdrawn_from=None), instrument_out=False
        )

    def _with_arrival(self, line: Line) -> ArmHistory:
        arrived = "joints_rad" in line
        joints_rad, ended = _joints_rad(line) if arrived else None, self.under_way
        place, trail, journeys = self.place, self.trail, self.journeys
        if arrived and ended == MotionKind.WITHDRAW and place.axis is not None:
            place = replace(place, axis=None, withdrawn_from=place.axis.trajectory)
        refused = not arrived and line.get("at_home") is True and place.axis is None  # before it began
        if refused or (arrived and ended == MotionKind.START):
            journeys -= 1
        if joints_rad is not None and ended == MotionKind.BACK:
            trail = self._cut_trail(joints_rad)
        elif joints_rad is not None and ended not in (MotionKind.START, MotionKind.INSERT):
            trail = (*trail, joints_rad)[-TRAIL:]
        moved = replace(self, place=replace(place, moved=journeys > 0), journeys=journeys, under_way=None)
        return replace(moved, trail=trail)._with_rest(line.get("at_home"))

    def _with_look(self, line: Line) -> ArmHistory:
        """Apply a comparison of the measured joints with home, which overrides earlier motions."""
        if (axis := line.get("axis")) is not None:
            found = InsertionAxis.from_plain(str(line["trajectory"]), axis)
            place = replace(
                self.place,
                axis=found,
                withdrawn_from=None,
                instrument_may_be_inside=found.trajectory,
                assumed=True,
            )
            return replace(self, place=place, instrument_out=False)._with_rest(False)
        if line["at_home"] is True:  # jogged off its axis, if it was on one
            return replace(self, place=replace(self.place, axis=None))._with_rest(True)
        return self._with_rest(False)

    def _with_rest(self, at_home: object) -> ArmHistory:
        """Set the place of the resting arm. `at_home` is None if it was not measured."""
        if self.place.axis is not None:
            return replace(self, place=replace(self.place, place_kind=PlaceKind.ON_AXIS))
        place_kind = (
            PlaceKind.UNKNOWN if at_home is None else PlaceKind.HOME if at_home is True else PlaceKind.AWAY
        )
        trail = () if place_kind is PlaceKind.HOME else self.trail
        return replace(self, place=replace(self.place, place_kind=place_kind), trail=trail)

    def _cut_trail(self, joints_rad: JointVector) -> tuple[JointVector, ...]:
        """Cut the trail back to the position that the arm returned to."""
        for number in range(len(self.trail), 0, -1):
            if stands_at(joints_rad, self.trail[number - 1]):
                return self.trail[:number]
        return self.trail

    def _with_stage(self, line: Line) -> ArmHistory:
        trajectory, stop = str(line["trajectory"]), line.get("stop")
        if line.get("doubted") is True:
            return replace(self, doubted=self.doubted | {trajectory})
        if isinstance(stop, Mapping):
            return replace(self, stops={**self.stops, trajectory: stop})
        if isinstance(opening := line.get("opening"), Mapping):
            return replace(self, openings={**self.openings, trajectory: opening})
        if (reason := line.get("interrupted")) is not None:
            return replace(self, interruptions={**self.interruptions, trajectory: str(reason)})
        tasks = {**self.stages.get(trajectory, {}), str(line["task"]): bool(line["done"])}
        known = replace(self, stages={**self.stages, trajectory: tasks})
        if not line["done"]:
            return known
        others = {name: reason for name, reason in self.interruptions.items() if name != trajectory}
        return replace(known, interruptions=others)


def arm_history(lines: Iterable[Line], arm: str = MASTER) -> ArmHistory:
    """Build an arm's history from journal lines. Raises PRO-011 for a line this version cannot read."""
    return reduce(_fold_line, lines, ArmHistory(arm))


def fold_history(chain: JournalChain, lost: Sequence[Line] = (), arm: str = MASTER) -> ArmHistory:
    """Build an arm's history from the journal of an ended program and the lines `lost` at its end.

    Raises as `arm_history`.
    """
    ending: dict[str, JournalValue] = {"entry": Entry.RESTARTED, "torn_bytes": len(chain.torn)}
    return _fold_line(arm_history(chain.lines, arm), ending | lost_as_plain(lost))


def fold_arms(chain: JournalChain, lost: Sequence[Line] = ()) -> tuple[ArmHistory, ArmHistory]:
    """Build the histories of master and assistant; that of a missing assistant is empty. Raises as above."""
    return fold_history(chain, lost), fold_history(chain, lost, ASSISTANT)


def describe_instrument(master: ArmPlace, held: HeldInstrument | None) -> str | None:
    """Describe where an instrument is or may be, in the guide or a holder; None if nowhere."""
    if held is not None and held.drill is not None:  # a drill is never told as an instrument
        inside = master.instrument_may_be_inside
        return held.description + ("" if inside is None else f"; it is or may be in {inside}")
    return master.instrument_description or (None if held is None else held.description)


def is_any_arm_out(chain: JournalChain, lost: Sequence[Line] = ()) -> bool:
    """Return whether an ended program may have left an arm away from home. Raises as above."""
    return any(arm.place.is_out for arm in fold_arms(chain, lost))


def _joints_rad(line: Line) -> JointVector:
    return cast("JointVector", tuple(cast("list[float]", line["joints_rad"])))


def _held(line: Line) -> HeldInstrument:
    tip_mm, at_bore = cast("float", line["tip_mm"]), cast("list[str]", line["at_bore"])
    drill = None if line.get("drill") is None else HeldDrill.model_validate(line["drill"])
    return HeldInstrument(str(line["trajectory"]), tip_mm, tuple(at_bore), drill)


def _fold_line(history: ArmHistory, line: Line) -> ArmHistory:
    try:
        return history.with_line(line)
    except (LookupError, TypeError, ValueError) as error:
        raise JournalCorrupt(
            f"line {line.get('sequence')}, {line.get('entry')}, is not as this version writes it"
        ) from error


class ArmLog:
    """Log of one arm: its journal, its history and its home position."""

    def __init__(self, journal: Journal, clock: Clock, history: ArmHistory) -> None:
        """Take `history` as the state after all lines already in the journal."""
        self._journal = journal
        self._clock = clock
        self.history = history
        self.home_rad: JointVector | None = None

    def write(self, entry: Entry, **data: JournalValue) -> None:
        """Journal an event before it happens; the line is on disk on return. Raises PRO-003."""
        self._journal.write(entry, self._clock.now_s(), arm=self.history.arm, **data)
        self.history = self.history.with_line({"entry": entry, "arm": self.history.arm, **data})

    def note(self, entry: Entry, **data: JournalValue) -> None:
        """Journal an event that has already happened. Raises PRO-003."""
        self._journal.note(entry, self._clock.now_s(), arm=self.history.arm, **data)
        self.history = self.history.with_line({"entry": entry, "arm": self.history.arm, **data})

    def is_home(self, joints_rad: JointVector) -> bool | None:
        """Return whether these joints are at home, or None before home is set."""
        return None if self.home_rad is None else stands_at(joints_rad, self.home_rad)
