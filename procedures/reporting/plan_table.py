"""What was planned for each trajectory, and how the path check would bring the guide there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from procedures.planning.motions import BACK
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.path_check import CheckedPaths, ClosestApproach, MotionPreview
from procedures.steps.clinical.plan_check import CheckedPlan


@dataclass(frozen=True)
class MotionRow:
    """One checked motion: its end points, and its clearance to the head and to anything else."""

    start: str
    end: str
    kind: str
    head_mm: float | None
    closest: ClosestApproach | None


@dataclass(frozen=True)
class PlanRow:
    """One trajectory: entry and target in LPS mm, angles about the axis, clearance of its motions.

    What only the path check provides is None before it, and for a trajectory that was left out.
    """

    name: str
    entry_mm: tuple[float, float, float]
    target_mm: tuple[float, float, float]
    depth_mm: float
    margin_mm: float
    planned_angle_deg: float
    turn_deg: float | None
    strategy: str | None
    motions: tuple[MotionRow, ...]

    @property
    def nearest(self) -> MotionRow | None:
        """The motion that comes closest to anything."""
        known = [one for one in self.motions if one.closest is not None]
        return min(known, key=lambda one: one.closest.distance_mm if one.closest else math.inf, default=None)

    @property
    def nearest_head_mm(self) -> float | None:
        """Least distance of anything moving to the head."""
        return min((one.head_mm for one in self.motions if one.head_mm is not None), default=None)


def plan_rows(reading: RunReading) -> tuple[PlanRow, ...]:
    """A row for each planned trajectory."""
    checked, paths = reading.find(CheckedPlan), reading.find(CheckedPaths)
    if checked is None:
        return ()
    return tuple(
        PlanRow(
            name=one.id,
            entry_mm=one.entry_mm,
            target_mm=one.target_mm,
            depth_mm=one.depth_mm,
            margin_mm=one.margin_mm,
            planned_angle_deg=one.free_angle_deg,
            turn_deg=_turn_deg(paths, one.id),
            strategy=None if paths is None or one.id in paths.left_out else paths.strategy_of(one.id),
            motions=() if paths is None else _motions(paths.motions, one.id),
        )
        for one in checked.plan.trajectories
    )


def _turn_deg(paths: CheckedPaths | None, trajectory: str) -> float | None:
    turn_rad = None if paths is None else paths.free_angle_turns_rad.get(trajectory)
    return None if turn_rad is None else math.degrees(turn_rad)


def _motions(previews: Sequence[MotionPreview], trajectory: str) -> tuple[MotionRow, ...]:
    """The motions to and from poses of this trajectory, in order; a line back clears what the line clears."""
    return tuple(
        MotionRow(one.start, one.end, one.kind, one.nearest_to_head_mm, one.closest)
        for one in previews
        if trajectory in (one.start.split("/")[0], one.end.split("/")[0]) and one.kind != BACK
    )
