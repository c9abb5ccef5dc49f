"""How a run left its arm, according to its journal: the way it came, the guide on its axis, the
instrument."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import cast

from procedures.journal.journal import Entry, Line
from procedures.workcell.insertion import Insertion
from procedures.workcell.worked_stages import Stages, Stops
from ronna_hw.devices.readings import JointVector
from ronna_hw.evidence.errors import JournalCorrupt


@dataclass(frozen=True)
class ArmAsLeft:
    """`trail` is where the arm was since it left home, `motions` how many it made.

    A guide counts as on its axis from the intent to approach along it to the end of its withdrawal, an
    instrument as inside from before it goes in until it was confirmed to be out.
    """

    trail: tuple[JointVector, ...] = ()
    insertion: Insertion | None = None
    withdrawn_from: str | None = None
    motions: int = 0
    instrument_in: str | None = None
    instrument_out: bool = False  # confirmed since the guide was brought there last
    stages: Stages = field(default_factory=dict)  # of the work through the guide
    stops: Stops = field(default_factory=dict)  # of the instrument
    cut_short: bool = False  # the last motion has no recorded end: the arm may be anywhere on its way

    @property
    def away(self) -> bool:
        """As `Workcell.away`, as far as it was written down; also after a motion that was cut short."""
        return self.insertion is not None or bool(self.trail) or self.cut_short


def arm_as_left(lines: Iterable[Line]) -> ArmAsLeft:
    """Follow the motions of a journal; raises PRO-011 when one is not as this version writes it."""
    trail: list[JointVector] = []
    insertion: Insertion | None = None
    withdrawn_from: str | None = None
    motion: Line = {}
    motions = 0
    instrument_in: str | None = None
    instrument_out = False
    stages: Stages = {}
    stops: Stops = {}
    cut_short = False
    for line in lines:
        if line["entry"] == Entry.MOTION:
            motion, motions, cut_short = line, motions + 1, True
            if line.get("what") == "insert":
                insertion, withdrawn_from, instrument_out = _insertion(line), None, False
        elif line["entry"] == Entry.INSTRUMENT:
            instrument_out = not line.get("inside")
            instrument_in = None if instrument_out else str(line.get("trajectory"))
        elif line["entry"] == Entry.STAGE:
            name, stop = str(line["trajectory"]), line.get("stop")
            if isinstance(stop, Mapping):
                stops[name] = stop
            else:
                stages.setdefault(name, {})[str(line["task"])] = bool(line["done"])
        elif line["entry"] == Entry.MOVED and "joints_rad" in line:
            what, cut_short = motion.get("what"), False
            if what == "withdraw" and insertion is not None:
                withdrawn_from = insertion.trajectory
                insertion = None
            elif what == "home":
                trail.clear()
            elif what != "insert":
                trail.append(cast("JointVector", tuple(cast("list[float]", line["joints_rad"]))))
    return ArmAsLeft(
        tuple(trail),
        insertion,
        withdrawn_from,
        motions,
        instrument_in,
        instrument_out,
        stages,
        stops,
        cut_short,
    )


def _insertion(line: Line) -> Insertion:
    try:
        return Insertion.from_plain(str(line["trajectory"]), line["axis"])
    except (KeyError, TypeError, ValueError) as error:
        raise JournalCorrupt(
            f"line {line.get('sequence')} does not give the position of the guide"
        ) from error
