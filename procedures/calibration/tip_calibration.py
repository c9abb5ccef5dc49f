"""Calibration of the guide's tip in the tool frame of the stereo head, which shares its mount.

In one orientation, and within millimetres of one position, an arm's errors are equal with the head over the
ball and with the tip in the divot that replaces the ball. The difference of the two is the tip relative to
the head's measurement, and hardly depends on the arm:

    tip = T'^-1 (T ball + dials)    T, T': ROBOT <- TOOL over the ball and in the divot

Pivoting about the divot provides a second answer, which does not assume ball and divot at the same position:
the tip turns with the tool, the gap between divot and ball stays. The gap must be small. Held-out readings
validate the result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import fdtri

from procedures.calibration.errors import (
    BAD_OBSERVATIONS,
    BALL_AND_DIVOT_APART,
    FAR_FROM_RECORD,
    READING_IMPLAUSIBLE,
    DoesNotFit,
)
from procedures.calibration.head_calibration import LIFE, new_identifier
from procedures.calibration.head_model import pose_record
from procedures.calibration.observations import FlangePose, Measurements
from procedures.calibration.pose_set import require_count, require_scatter, require_spread, rms_mm
from ronna_hw.arrays import Array
from ronna_hw.calibration import (
    ArmCalibration,
    Numbers3,
    PoseRecord,
    StereoHeadCalibration,
    Strict,
    ToolTipCalibration,
)
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit, format_distinct
from ronna_hw.vectors import JointVector

LOOKS_FILE = "tip-looks.json"

LEAST_READINGS = 8  # with fewer, pivoting leaves more than MOST_OPEN_MM undetermined with some good stands
SAME_ORIENTATION_RAD = float(np.radians(0.5))  # beyond this, the arm's errors do not cancel
LARGEST_SCATTER_MM = 0.08  # per axis: good arms and stands show 0.02 to 0.03
LEAST_SCATTER_MM = 0.003  # nothing repeats better
LARGEST_GAP_MM = 0.08  # between ball and divot; a smaller gap adds to the tip's error: the stand must be good
MOST_OPEN_MM = 0.2  # no larger gap goes unnoticed; good readings at the step's poses leave 0.07 to 0.17
GAP_SIGMAS = 3.0  # standard errors, if pivoting leaves more than that undetermined
LARGEST_PIVOT_SCATTER_MM = 0.05  # per axis: good ones show up to 0.035; a larger one would excuse any gap

MADE_BY = "ronna-procedure calibrate tool-tip"
LEAST_VALIDATION = 2
ACCEPTED = 1e-4  # probability of rejecting a good calibration
MODEL_SHARE = 0.25  # of the predicted variance: resolution of the dials, arm errors that do not cancel
STAND_MM = 0.01  # between divot and ball centre, per axis: manufacturing tolerance of such stands
DIALS_TRAVEL_MM = 6.0
FAR_MM = 10.0  # no guide deviates this much from its drawing


class BallLook(Strict):
    """The stereo head's view of the ball in one orientation."""

    joints_rad: JointVector = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: FlangePose
    ball_mm: Numbers3 = Field(description="The ball in the tool frame of the head's record.")


class DivotReading(Strict):
    """Dial reading with the guide's tip in the divot, in the same orientation as a view of the ball."""

    look: int = Field(ge=0, description="Number of that measurement.")
    joints_rad: JointVector = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: FlangePose
    dials_mm: Numbers3 = Field(description="Offset of the divot from the ball's centre, robot axes.")


class TipLooks(Measurements):
    """All views and readings for one tip calibration, and the records in use."""

    RECORDS: ClassVar = {"stereo_head": "stereo_head", "tool_tip": "start", "arm": "arm_record"}

    arm: str = Field(description="Name of the arm's kinematic model.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head in use.")
    start: ToolTipCalibration = Field(description="The record of the tip in use, or the drawing.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[BallLook, ...] = Field(description="The measurements of the ball, in order.")
    readings: tuple[DivotReading, ...] = Field(description="The readings, at most one for each measurement.")
    validation: tuple[int, ...] = Field(description="Numbers of the measurements held out for validation.")


@dataclass(frozen=True)
class TipResult:
    """New tip record and its quality; `misses_mm` (m, 3) of held-out readings, tool frame."""

    fit: TipFit
    misses_mm: Array
    predicted_mm: float
    change_mm: float
    tool_tip: ToolTipCalibration


def calibrate_tip(observed: TipLooks, *, life: timedelta = LIFE) -> TipResult:
    """Compute a dated record from readings. Raises CAL-002 to CAL-005, CAL-017 to CAL-019."""
    _require_plausible(observed)
    held_out = set(observed.validation)
    fit = fit_tip(pairs_of(observed, [one for one in observed.readings if one.look not in held_out]))
    kept = [one for one in observed.readings if one.look in held_out]
    misses, predicted_mm = _validate(fit, pairs_of(observed, kept))
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    before = observed.start.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    change_mm = float(np.linalg.norm(head.apply(fit.tip_mm) - before.translation_mm))
    if change_mm > FAR_MM:
        raise FAR_FROM_RECORD(
            "the tip is not at its recorded position",
            limit=f"{FAR_MM:g} mm",
            got=f"{format_against_limit(change_mm, FAR_MM, 1)} mm",
        )
    # A divot shows where the tip is, not where the guide points: direction and its error are kept.
    rigid = RigidTransform.from_components(head.apply(fit.tip_mm), before.rigid.rotation)
    gap_mm = max(fit.hidden_gap_mm, np.sqrt(3.0) * STAND_MM)
    stated_mm = float(np.sqrt(np.trace(fit.covariance_mm2) + gap_mm**2))
    return TipResult(
        fit=fit,
        misses_mm=misses,
        predicted_mm=predicted_mm,
        change_mm=change_mm,
        tool_tip=ToolTipCalibration(
            identifier=new_identifier("tool-tip", observed.created),
            created=observed.created,
            expires=observed.created + life,
            made_by=MADE_BY,
            stated_error_mm=stated_mm,
            tool_number=observed.start.tool_number,
            flange_from_tool=pose_record(Transform(Frame.FLANGE, Frame.TOOL, rigid)),
            stated_direction_error_rad=observed.start.stated_direction_error_rad,
        ),
    )


def require_plausible(dials_mm: tuple[float, float, float]) -> None:
    """Raise CAL-018 for values that the three millimetre dials cannot show."""
    if not all(np.isfinite(dials_mm)) or max(map(abs, dials_mm)) > DIALS_TRAVEL_MM:
        raise READING_IMPLAUSIBLE(
            "the dials cannot show this",
            limit=f"each within ±{DIALS_TRAVEL_MM:g} mm",
            got=" ".join(f"{value:g}" for value in dials_mm),
        )


def _require_plausible(observed: TipLooks) -> None:
    numbers = [one.look for one in observed.readings]
    if len(set(numbers)) < len(numbers) or any(number >= len(observed.looks) for number in numbers):
        raise BAD_OBSERVATIONS(
            "each reading of the dials needs its own measurement", expected=f"0 to {len(observed.looks) - 1}"
        )
    for one in observed.readings:
        require_plausible(one.dials_mm)


def _validate(fit: TipFit, held_out: TipPairs) -> tuple[Array, float]:
    """Return misses (m, 3) of held-out readings and their expected rms in mm."""
    require_count(held_out.count, LEAST_VALIDATION, "too few readings to validate the tip")
    misses = tips_of(held_out) - fit.tip_mm
    variance = fit.scatter_mm**2 + float(np.trace(fit.covariance_mm2)) / 3.0
    found_mm = rms_mm(misses)
    # The scatter is estimated from few readings: the limit includes its own error (Fisher's F).
    ratio = float(fdtri(3 * held_out.count, 3 * (len(fit.misses_mm) - 1), 1.0 - ACCEPTED))
    limit_mm = float(np.sqrt(3.0 * variance * ratio * (1.0 + MODEL_SHARE)))
    if found_mm > limit_mm:
        rms, limit = format_distinct(found_mm, limit_mm, 3)
        raise DoesNotFit(
            "the tip does not agree with the readings kept for validation",
            limit=f"{limit} mm rms",
            got=f"{rms} mm",
        )
    return misses, float(np.sqrt(3.0 * variance))


@dataclass(frozen=True)
class TipFit:
    """Fitted tip (3,) in the head's tool frame, with covariance (3, 3) mm2; `scatter_mm` per axis.

    `gap_mm` (3,) is the divot's offset from the ball according to pivoting, robot axes, with a standard error
    of `gap_error_mm` in space.
    """

    tip_mm: Array
    covariance_mm2: Array
    scatter_mm: float
    misses_mm: Array
    gap_mm: Array
    gap_error_mm: float

    @property
    def hidden_gap_mm(self) -> float:
        """Standard deviation of a gap hidden in the tip; accepted gaps are at most three times as large."""
        return max(self.gap_error_mm, float(np.linalg.norm(self.gap_mm)) / GAP_SIGMAS)


def fit_tip(pairs: TipPairs) -> TipFit:
    """Fit the tip to readings in the divot. Raises CAL-002 to CAL-004, CAL-019."""
    _require_usable(pairs)
    tips = tips_of(pairs)
    tip = tips.mean(axis=0)
    misses = tips - tip
    scatter = max(float(np.sqrt(np.sum(misses**2) / (3 * (pairs.count - 1)))), LEAST_SCATTER_MM)
    require_scatter(
        scatter,
        LARGEST_SCATTER_MM,
        "the readings do not agree on one tip position",
        "Check that stand, guide and dials are rigid and that x, y and z are not mixed up; then repeat.",
    )
    gap, gap_error, pivot_scatter = _fit_gap(pairs)
    require_scatter(
        pivot_scatter,
        LARGEST_PIVOT_SCATTER_MM,
        "pivoting cannot show whether the divot is where the ball was: the readings scatter too much",
        "Check that stand, guide and dials are rigid; then repeat.",
        decimals=3,
    )
    if GAP_SIGMAS * gap_error > MOST_OPEN_MM:
        raise DoesNotFit(
            "pivoting cannot show whether the divot is where the ball was: too few "
            "orientations, or too similar",
            limit=f"an uncertainty of {MOST_OPEN_MM:g} mm",
            got=f"{format_against_limit(GAP_SIGMAS * gap_error, MOST_OPEN_MM, 2)} mm",
            action="Tilt the guide farther to all sides, or read more orientations; then repeat.",
        )
    limit = max(LARGEST_GAP_MM, GAP_SIGMAS * gap_error)
    if np.linalg.norm(gap) > limit:
        raise BALL_AND_DIVOT_APART(
            "according to the pivoting, the divot is not where the ball was",
            limit=f"{limit:.2f} mm",
            got=f"{format_against_limit(float(np.linalg.norm(gap)), limit, 2)} mm",
        )
    covariance = scatter**2 / pairs.count * np.eye(3)
    return TipFit(tip, covariance, scatter, misses, gap, gap_error)


@dataclass(frozen=True)
class TipPairs:
    """Poses over ball and divot in m orientations, in the head's recorded tool frame."""

    at_ball: Array  # (m, 4, 4) ROBOT <- TOOL of the head over the ball
    at_divot: Array  # (m, 4, 4) the same with the tip in the divot
    ball_mm: Array  # (m, 3) tool frame
    dials_mm: Array  # (m, 3) robot axes

    @property
    def count(self) -> int:
        """Number of orientations."""
        return len(self.at_ball)


def pairs_of(observed: TipLooks, readings: Sequence[DivotReading]) -> TipPairs:
    """Convert readings and their views to arrays."""
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)

    def tools(poses: Sequence[PoseRecord]) -> Array:
        found: list[Transform] = [pose.transform(Frame.ROBOT, Frame.FLANGE) @ head for pose in poses]
        return np.array([one.as_matrix() for one in found]).reshape(-1, 4, 4)

    looks = [observed.looks[one.look] for one in readings]
    return TipPairs(
        at_ball=tools([one.robot_from_flange for one in looks]),
        at_divot=tools([one.robot_from_flange for one in readings]),
        ball_mm=np.array([one.ball_mm for one in looks]).reshape(-1, 3),
        dials_mm=np.array([one.dials_mm for one in readings]).reshape(-1, 3),
    )


def tips_of(pairs: TipPairs) -> Array:
    """Compute the tip (m, 3) in the tool frame from each individual reading."""
    offsets = _offsets_mm(pairs)
    return np.asarray(np.einsum("mji,mj->mi", pairs.at_divot[:, :3, :3], offsets))


def _require_usable(pairs: TipPairs) -> None:
    action = "Read the dials in more orientations."
    require_count(pairs.count, LEAST_READINGS, "too few readings of the divot", action)
    action = "Tilt the guide by 20 degrees or more to all sides of the divot."
    require_spread(pairs.at_divot[:, :3, :3], "the tip was pivoted over too narrow a cone", action)
    between = pairs.at_ball[:, :3, :3].transpose(0, 2, 1) @ pairs.at_divot[:, :3, :3]
    angle_rad = float(Rotation.from_matrix(between).magnitude().max())
    if angle_rad > SAME_ORIENTATION_RAD:
        raise DoesNotFit(
            "head and tip were not moved there in the same orientation",
            limit=f"{np.degrees(SAME_ORIENTATION_RAD):g} deg",
            got=f"{format_against_limit(math.degrees(angle_rad), math.degrees(SAME_ORIENTATION_RAD), 1)} deg",
        )


def _fit_gap(pairs: TipPairs) -> tuple[Array, float, float]:
    """Fit the divot's offset from the ball: offset, 3-D standard error, scatter per reading and axis.

    Solves `offsets = R tip - gap` for both unknowns.
    """
    rotations, offsets = pairs.at_divot[:, :3, :3], _offsets_mm(pairs)
    rows = np.concatenate([rotations, np.tile(-np.eye(3), (pairs.count, 1, 1))], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(rows.T @ rows)
    solution = inverse @ rows.T @ offsets.ravel()
    misses = rows @ solution - offsets.ravel()
    variance = max(float(misses @ misses) / (len(misses) - 6), LEAST_SCATTER_MM**2)
    return solution[3:], float(np.sqrt(variance * np.trace(inverse[3:, 3:]))), float(np.sqrt(variance))


def _offsets_mm(pairs: TipPairs) -> Array:
    """Return offsets (m, 3) from the tool centre at the divot to ball plus dials, robot axes, mm."""
    ball = np.einsum("mij,mj->mi", pairs.at_ball[:, :3, :3], pairs.ball_mm) + pairs.at_ball[:, :3, 3]
    return np.asarray(ball + pairs.dials_mm - pairs.at_divot[:, :3, 3])
