"""Ways of both arms along the axis of a trajectory, in and out, as the journal has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from procedures.journal.journal import Entry, Line, theatre_time_s
from procedures.operator.question import Topic
from procedures.workcell.arm_history import MotionKind
from ronna_hw.roles import MASTER

CLOSEST = "closest: "  # line of a question about a motion
ASKED = {MotionKind.INSERT: Topic.APPROACH, MotionKind.WITHDRAW: Topic.RETREAT}


@dataclass(frozen=True)
class ArmWay:
    """Way of an arm along an axis: into its guide position or the bore, or out of it and home.

    `clearance` is what was announced before it moved, empty if nobody was asked.
    """

    trajectory: str
    arm: str
    is_out: bool
    travel_mm: float
    clearance: str
    begin_s: float
    end_s: float | None  # None: the journal ends before
    error: str = ""
    motions_home: int = 0  # after a way out
    errors_home: tuple[str, ...] = ()  # codes of those that were stopped
    home_s: float | None = None  # theatre time at home; None if it did not come there

    @property
    def name(self) -> str:
        """Name of the way by what it moves."""
        moved = "guide" if self.arm == MASTER else "instrument"
        return f"{moved} {'out' if self.is_out else 'in'}"

    @property
    def lasted_s(self) -> float | None:
        """Theatre time along the axis."""
        return None if self.end_s is None else self.end_s - self.begin_s

    @property
    def ending(self) -> str:
        """Ending of the way in words."""
        if self.error:
            return f"stopped: {self.error}"
        if self.end_s is None:
            return "not ended"
        if not self.is_out:
            return "arrived"
        if self.home_s is None:
            return "out, not home"
        stops = f", {', '.join(self.errors_home)} on the way: back as it came" if self.errors_home else ""
        return f"home after {self.motions_home} {'motion' if self.motions_home == 1 else 'motions'}{stops}"


def list_arm_ways(journal: Sequence[Line]) -> tuple[ArmWay, ...]:
    """List the ways along axes in their order."""
    ways: list[ArmWay] = []
    announced: dict[str, str] = {}  # closest approach by topic, of the latest question
    under_way: dict[tuple[str, object], int] = {}  # index of the way by arm and motion
    leaving: dict[str, int] = {}  # index of the latest way out of an arm that is not home yet
    for line in journal:
        arm = str(line.get("arm", MASTER))
        match line["entry"]:
            case Entry.CONFIRMATION:
                topic = str(line.get("topic")).partition(":")[0]
                announced[topic] = _find_clearance(str(line.get("value", "")))
            case Entry.MOTION if line.get("what") in ASKED:
                kind = MotionKind(str(line["what"]))
                under_way[arm, line.get("number")] = len(ways)
                ways.append(_begin(line, kind, arm, announced.pop(ASKED[kind], "")))
            case Entry.MOVED if (arm, line.get("number")) in under_way:
                index = under_way.pop((arm, line.get("number")))
                error = str(line.get("error", ""))
                ways[index] = replace(ways[index], end_s=theatre_time_s(line), error=error)
                if ways[index].is_out and not error:
                    leaving[arm] = index
            case Entry.MOVED if arm in leaving:
                index = leaving[arm]
                ways[index] = _go_home(ways[index], line)
                if line.get("at_home"):
                    del leaving[arm]
    return tuple(ways)


def _find_clearance(value: str) -> str:
    lines = (line.removeprefix(CLOSEST) for line in value.splitlines() if line.startswith(CLOSEST))
    return next(lines, "")


def _begin(line: Line, kind: MotionKind, arm: str, clearance: str) -> ArmWay:
    axis = line.get("axis")
    travel_mm = axis.get("travel_mm") if isinstance(axis, dict) else None
    return ArmWay(
        trajectory=str(line.get("trajectory")),
        arm=arm,
        is_out=kind is MotionKind.WITHDRAW,
        travel_mm=float(travel_mm) if isinstance(travel_mm, int | float) else 0.0,
        clearance=clearance,
        begin_s=theatre_time_s(line),
        end_s=None,
    )


def _go_home(way: ArmWay, line: Line) -> ArmWay:
    error = str(line.get("error", ""))
    return replace(
        way,
        motions_home=way.motions_home + 1,
        errors_home=(*way.errors_home, *([error] if error else [])),
        home_s=theatre_time_s(line) if line.get("at_home") else None,
    )
