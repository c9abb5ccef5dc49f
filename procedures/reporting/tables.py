"""Rows of the report's tables: predicted and true target errors, the plan, and its checked motions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from procedures.operator.margin import MarginVerdict, judge_error, remark_on_limit
from procedures.planning.motions import BACK
from procedures.planning.pose_name import PoseName
from procedures.reporting.outcome import ErrorParts, Truth
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.path_check import CheckedPaths, ClosestApproach, MotionPreview
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import Prediction
from procedures.steps.clinical.target_measurement import MeasuredTarget
from procedures.strategies.pose_values import PoseValues
from procedures.strategies.skin_looks import SKIN
from ronna_hw.collision_config import HEAD


@dataclass(frozen=True)
class TargetRow:
    """Table row for a target. The error is known only in simulation, and only if the tip arrived."""

    target: str
    depth_mm: float | None
    predicted: Prediction
    error_mm: float | None
    lateral_mm: float | None
    axial_mm: float | None
    measured_mm: float | None = None  # by the stereo head in place of the guide, on a phantom
    margin_mm: float | None = None  # accepted by the plan
    strategy: str | None = None  # used, which may be another than the run's
    parts: ErrorParts | None = None

    @property
    def known_mm(self) -> float | None:
        """The largest known error."""
        return max((one for one in (self.error_mm, self.measured_mm) if one is not None), default=None)

    @property
    def verdict(self) -> MarginVerdict | None:
        """The error against the margin, or where no error is known what was predicted of it."""
        if self.margin_mm is None:
            return None
        return judge_error(self.margin_mm, self.predicted.rms_mm, self.predicted.limit_mm, self.known_mm)

    @property
    def remark(self) -> str:
        """Remark on a known error within the margin of which more was predicted; empty without one."""
        return remark_on_limit(self.verdict, self.margin_mm, self.predicted.limit_mm)


class GuidePose(NamedTuple):
    """Pose in which the guide was held at a target, by the nominal arm at the measured joints."""

    target: str | None
    values: PoseValues


class ShareRow(NamedTuple):
    """Share of one source in the predicted errors, one for each target; None where it has none."""

    source: str
    rms_mm: tuple[float | None, ...]


@dataclass(frozen=True)
class TargetTable:
    """Rows of all targets, with what they have in common."""

    rows: tuple[TargetRow, ...]

    @property
    def errors_mm(self) -> tuple[float, ...]:
        """Known errors of the tip."""
        return tuple(row.error_mm for row in self.rows if row.error_mm is not None)

    @property
    def mean_error_mm(self) -> float:
        """Mean of the known errors."""
        return sum(self.errors_mm) / len(self.errors_mm)

    @property
    def all_within(self) -> bool:
        """Whether every target is known to be within its margin."""
        return all(row.verdict is MarginVerdict.WITHIN for row in self.rows)

    @property
    def any_measured(self) -> bool:
        """Whether the stereo head has measured any target in place of the guide."""
        return any(row.measured_mm is not None for row in self.rows)

    @property
    def split(self) -> tuple[TargetRow, ...]:
        """Targets at which the shares of registration and arm are known."""
        return tuple(row for row in self.rows if row.parts is not None)

    @property
    def prediction(self) -> Prediction:
        """Prediction of the first target; confidence, exclusions and assumptions are those of all."""
        return self.rows[0].predicted

    @property
    def shares(self) -> tuple[ShareRow, ...]:
        """Shares of the predicted errors, by the sources of the first target."""
        by_target = [{share.source: share.rms_mm for share in row.predicted.budget} for row in self.rows]
        return tuple(
            ShareRow(share.source, tuple(shares.get(share.source) for shares in by_target))
            for share in self.prediction.budget
        )

    @property
    def has_budget(self) -> bool:
        """Whether any prediction states its shares."""
        return any(row.predicted.budget for row in self.rows)


def target_rows(reading: RunReading, truth: Truth) -> tuple[TargetRow, ...]:
    """Return a row for each registered target, with the prediction of its registration."""
    plan = reading.find(CheckedPlan)
    depth_mm = {} if plan is None else {one.id: one.depth_mm for one in plan.plan.trajectories}
    margin_mm = {} if plan is None else {one.id: one.margin_mm for one in plan.plan.trajectories}
    truths, strategies = {one.id: one for one in truth.targets}, reading.strategies
    measured_mm = {
        one.record.trajectory: one.result.error_mm for one in reading.valid_results(MeasuredTarget)
    }
    rows = []
    for one in (one for used in reading.registrations for one in used.predictions):
        name, true = one.target, truths.get(one.target)
        error_mm = None if true is None else true.application_error_mm
        lateral_mm, axial_mm = (None, None) if true is None else (true.lateral_mm, true.axial_mm)
        parts = None if true is None else true.parts
        others = (measured_mm.get(name), margin_mm.get(name), strategies.get(name), parts)
        rows.append(TargetRow(name, depth_mm.get(name), one, error_mm, lateral_mm, axial_mm, *others))
    return tuple(rows)


@dataclass(frozen=True)
class MotionRow:
    """Checked motion: end points, clearance to the head, and the two closest bodies of all."""

    start: PoseName
    end: PoseName
    kind: str
    head_mm: float | None
    closest: ClosestApproach | None

    @property
    def is_nearest_to_head(self) -> bool:
        """Whether the head is one of the two closest bodies: all others are further apart then."""
        return self.closest is not None and HEAD in (self.closest.first, self.closest.second)


@dataclass(frozen=True)
class PlanRow:
    """Table row for a trajectory: entry and target in LPS mm, angles about the axis, motion clearances.

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
        """The motion with the smallest clearance."""
        known = [one for one in self.motions if one.closest is not None]
        return min(known, key=lambda one: one.closest.distance_mm if one.closest else math.inf, default=None)

    @property
    def nearest_head_mm(self) -> float | None:
        """Smallest distance of any moving body to the head."""
        return min((one.head_mm for one in self.motions if one.head_mm is not None), default=None)


def plan_rows(reading: RunReading) -> tuple[PlanRow, ...]:
    """Return a row for each planned trajectory."""
    checked, paths = reading.find(CheckedPlan), reading.find(CheckedPaths)
    if checked is None:
        return ()
    strategies = reading.strategies
    return tuple(
        PlanRow(
            name=one.id,
            entry_mm=one.entry_mm,
            target_mm=one.target_mm,
            depth_mm=one.depth_mm,
            margin_mm=one.margin_mm,
            planned_angle_deg=one.free_angle_deg,
            turn_deg=_turn_deg(paths, one.id),
            strategy=strategies.get(one.id),
            motions=() if paths is None else _list_motions(paths.motions, one.id),
        )
        for one in checked.plan.trajectories
    )


def _turn_deg(paths: CheckedPaths | None, trajectory: str) -> float | None:
    turn_rad = None if paths is None else paths.free_angle_turns_rad.get(trajectory)
    return None if turn_rad is None else math.degrees(turn_rad)


def list_skin_motions(reading: RunReading) -> tuple[MotionRow, ...]:
    """Return the motions of the scan of the skin, which belong to no trajectory; none in a case without."""
    paths = reading.find(CheckedPaths)
    return () if paths is None else _list_motions(paths.motions, SKIN)


def _list_motions(previews: Sequence[MotionPreview], trajectory: str) -> tuple[MotionRow, ...]:
    """Return the motions of a trajectory in order, without retraced lines, which have the same clearance."""
    return tuple(
        MotionRow(one.start, one.end, one.kind, one.nearest_to_head_mm, one.closest)
        for one in previews
        if trajectory in (one.start.trajectory, one.end.trajectory) and one.kind != BACK
    )
