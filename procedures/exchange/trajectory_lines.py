"""Lines of the trajectories in the CT: as planned, as reached by the arm, and as found after the operation.

A reached line is that of the guide at the measured joints, mapped `ct <- robot` by the registration that led
there, with the tip where the depth stop holds it. It contains neither the error of the arm nor that of the
registration: no error at the target is known from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from procedures.exchange.allowed_fields import FOUND, PLANNED, REACHED
from procedures.exchange.export_tables import CT_FROM_LATER_CT, CT_FROM_ROBOT, IN_CT, CtIdentity, format_table
from procedures.exchange.slicer_markups import Colour, Point, build_markup, format_markups
from procedures.planning.guide import tip_beyond_tool_mm
from procedures.planning.plan_model import PlannedTrajectory
from procedures.postoperative.comparison import FoundTrajectory
from procedures.steps.clinical.work_progress import DepthStop
from procedures.strategies.trajectory import split_along
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform
from ronna_hw.tool_record import GuideBore

DIRECTIONS = {PLANNED: IN_CT, REACHED: CT_FROM_ROBOT, FOUND: CT_FROM_LATER_CT}
COLOURS: dict[str, Colour] = {PLANNED: (0.35, 0.77, 0.87), REACHED: (1.0, 0.62, 0.36), FOUND: (0.6, 0.9, 0.4)}
ENDS = {PLANNED: "target", REACHED: "tip", FOUND: "tip"}


@dataclass(frozen=True)
class TrajectoryLine:
    """Line of a trajectory in CT coordinates (LPS, mm); `kind` is planned, reached or found."""

    label: str
    kind: str
    entry_mm: Point
    end_mm: Point
    end: str = ""  # what the end is, if not as usual for its kind

    @property
    def length_mm(self) -> float:
        """Distance from entry to end."""
        return math.dist(self.entry_mm, self.end_mm)


@dataclass(frozen=True)
class Deviation:
    """Deviation of a tip from its planned target: in all, across the planned line and along it."""

    error_mm: float | None
    lateral_mm: float | None
    axial_mm: float | None  # positive is too deep


def planned_line(label: str, planned: PlannedTrajectory) -> TrajectoryLine:
    """Return the planned line of a trajectory."""
    return TrajectoryLine(label, PLANNED, planned.entry_mm, planned.target_mm)


def reached_line(
    label: str,
    planned: PlannedTrajectory,
    robot_from_tool: Transform,
    robot_from_ct: Transform,
    stop: DepthStop,
    bore: GuideBore,
) -> TrajectoryLine:
    """Return the line of the held guide, from its point nearest to the planned entry to the instrument's tip.

    The depth stop holds the tip, see `tip_beyond_tool_mm`.
    """
    held = robot_from_ct.inverse() @ robot_from_tool
    axis = held.rotation_matrix[:, 2]
    tip = held.translation_mm + tip_beyond_tool_mm(stop.read_mm, stop.bore_mm, bore.reach_mm) * axis
    entry = tip + float((np.array(planned.entry_mm) - tip) @ axis) * axis
    return TrajectoryLine(label, REACHED, _point(entry), _point(tip))


def found_line(label: str, found: FoundTrajectory) -> TrajectoryLine:
    """Return the line found in the CT after the operation; a drilled hole has no tip."""
    end = "" if found.tip_mm is not None else "point of the hole's axis at the target"
    return TrajectoryLine(label, FOUND, found.entry_mm, found.axis_at_target_mm, end)


def deviation(line: TrajectoryLine, planned: PlannedTrajectory) -> Deviation:
    """Return how far the end of a line is from the planned target."""
    off = np.subtract(line.end_mm, planned.target_mm)
    lateral_mm, axial_mm = split_along(off, planned.trajectory.axis_ct)
    return Deviation(float(np.linalg.norm(off)), lateral_mm, axial_mm)


def format_lines(lines: Iterable[TrajectoryLine], ct: CtIdentity, kind: str) -> str:
    """Format the lines of one kind as Slicer line markups."""
    return format_markups([_markup(one) for one in lines if one.kind == kind], ct, DIRECTIONS[kind])


def tabulate_lines(lines: Iterable[TrajectoryLine], ct: CtIdentity) -> str:
    """Format all lines as a CSV."""
    rows: list[dict[str, object]] = []
    for one in lines:
        points = {**_columns("entry", one.entry_mm), **_columns("end", one.end_mm)}
        line = {"trajectory": one.label, "line": one.kind, **points, "length_mm": one.length_mm}
        rows.append({**line, **ct.describe(DIRECTIONS[one.kind])})
    return format_table("lines.csv", rows)


def _markup(line: TrajectoryLine) -> dict[str, object]:
    name, direction = f"{line.label} {line.kind}", DIRECTIONS[line.kind]
    end = line.end or ENDS[line.kind]
    points = {
        f"{line.label} entry": (line.entry_mm, f"{line.kind} entry, {direction}"),
        f"{line.label} {ENDS[line.kind]}": (line.end_mm, f"{line.kind} {end}, {direction}"),
    }
    length = {
        "name": "length",
        "enabled": True,
        "value": line.length_mm,
        "units": "mm",
        "printFormat": "%-#4.4g%s",
    }
    return build_markup("Line", name, points, colour=COLOURS[line.kind], measurements=[length])


def _columns(end: str, point_mm: Point) -> dict[str, float]:
    return {f"{end}_{axis}_mm": value for axis, value in zip("LPS", point_mm, strict=True)}


def _point(values: Array) -> Point:
    x, y, z = values.tolist()
    return (x, y, z)
