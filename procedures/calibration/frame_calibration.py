"""Calibration of the reference frame on the arm's mount: poses, stored measurements, dated record.

The poses turn the frame about itself, in all directions, so it stays nearly in place. The tracker's smooth
error over its volume is then equal in all of them, and affects the tracker's pose rather than the frame's on
the flange.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum
from itertools import combinations
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from scipy.special import chdtri

from procedures.calibration.errors import FAR_FROM_RECORD, TOO_FEW_POSES, TRACKER_MOVED, DoesNotFit
from procedures.calibration.hand_eye import HandEye, PosePairs, misses_of, slopes_of, solve
from procedures.calibration.head_calibration import LIFE, new_identifier
from procedures.calibration.head_model import pose_record
from procedures.calibration.observations import FlangePose, Measurements
from procedures.calibration.pose_set import (
    PlannedLook,
    choose_held_out,
    order_by_orientation,
    plan_poses_about,
    require_count,
    rms_mm,
)
from procedures.registration.error_theory import propagate
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import LINK_TRANSLATION_MM
from ronna_hw.calibration import (
    ArmCalibration,
    PoseRecord,
    StereoHeadCalibration,
    Strict,
    TrackerFrameCalibration,
)
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit, format_distinct
from ronna_hw.vectors import JointVector

LOOKS_FILE = "frame-looks.json"

MADE_BY = "ronna-procedure calibrate tracker-frame"
LEAST_VALIDATION = 5
ACCEPTED = 1e-4  # probability of rejecting a good calibration
MODEL_SHARE = 0.25  # of the predicted variance: an arm's errors are not noise
MOVED_MM, MOVED_RAD = 0.2, float(np.radians(0.1))  # ten times the repeatability of arm and tracker
FAR_MM, FAR_RAD = 20.0, float(np.radians(10.0))  # no mount deviates this much from its drawing

TILT_RAD = float(np.radians(35.0))  # with more, the arm or the frame's own edge hides markers
TURN_RAD = float(np.radians(70.0))


class Use(StrEnum):
    """Purpose of a measurement."""

    FIT = "fit"
    VALIDATION = "validation"  # held out for validation
    RETURN = "return"  # repeated at the same pose: has anything moved?


class FrameLook(Strict):
    """Stationary pose, and the tracker's mean measurement there."""

    use: Annotated[Use, Field(strict=False)] = Field(description="Purpose of the measurement.")
    joints_rad: JointVector = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: FlangePose
    tracker_from_marker: PoseRecord = Field(description="Mean pose tracker <- reference frame.")
    frames: Annotated[int, Field(ge=1)] = Field(description="Measurements that show the frame.")


class FrameLooks(Measurements):
    """All measurements for one frame calibration, and the records in use."""

    RECORDS: ClassVar = {"stereo_head": "stereo_head", "tracker_frame": "start", "arm": "arm_record"}

    arm: str = Field(description="Name of the arm's kinematic model.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head on the same mount.")
    start: TrackerFrameCalibration = Field(description="The record in use, or the drawing.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[FrameLook, ...] = Field(description="The measurements, in order.")


def assign_uses(count: int, validation: int) -> tuple[Use, ...]:
    """Assign a use to each measurement, spreading those for validation evenly."""
    total = count + validation
    held_out = choose_held_out(total, validation)
    return tuple(Use.VALIDATION if number in held_out else Use.FIT for number in range(total))


def pairs_of(looks: Sequence[FrameLook]) -> PosePairs:
    """Convert measurements to arrays."""

    def matrices(poses: Sequence[Transform]) -> Array:
        return np.array([pose.as_matrix() for pose in poses]).reshape(-1, 4, 4)

    return PosePairs(
        matrices([one.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE) for one in looks]),
        matrices([one.tracker_from_marker.transform(Frame.TRACKER, Frame.MARKER) for one in looks]),
    )


@dataclass(frozen=True)
class FrameResult:
    """New record of the reference frame, and its quality.

    `misses_mm` and `misses_rad` (m, 3) of held-out measurements; `predicted_mm` and `predicted_rad`: their
    expected 3-D rms. `arm_error_mm` is the arm's contribution, which no measurement can separate from the
    frame: an error of its last link is a shift of the frame. `change_mm` and `change_rad`: from the previous
    record.
    """

    fit: HandEye
    misses_mm: Array
    misses_rad: Array
    predicted_mm: float
    predicted_rad: float
    arm_error_mm: float
    change_mm: float
    change_rad: float
    tracker_frame: TrackerFrameCalibration


def calibrate_frame(observed: FrameLooks, *, life: timedelta = LIFE) -> FrameResult:
    """Compute a dated record from measurements. Raises CAL-002 to CAL-004, CAL-015 to CAL-017."""
    _require_at_rest([one for one in observed.looks if one.use is Use.RETURN])
    fit = solve(pairs_of([one for one in observed.looks if one.use is Use.FIT]))
    validation_pairs = pairs_of([one for one in observed.looks if one.use is Use.VALIDATION])
    misses, predicted = _validate(fit, validation_pairs)
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    marker_pose = head.inverse() @ Transform.from_matrix(Frame.FLANGE, Frame.MARKER, fit.flange_from_marker)
    before = observed.start.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    change_mm, change_rad = _change(before, marker_pose)
    arm_error_mm = arm_share_mm(observed.arm_record)
    return FrameResult(
        fit=fit,
        misses_mm=misses[:, :3],
        misses_rad=misses[:, 3:],
        predicted_mm=predicted[0],
        predicted_rad=predicted[1],
        arm_error_mm=arm_error_mm,
        change_mm=change_mm,
        change_rad=change_rad,
        tracker_frame=TrackerFrameCalibration(
            identifier=new_identifier("tracker-frame", observed.created),
            created=observed.created,
            expires=observed.created + life,
            made_by=MADE_BY,
            stated_error_mm=float(np.hypot(fit.error_mm, arm_error_mm)),
            tool=observed.start.tool,
            tool_from_marker=pose_record(marker_pose),
        ),
    )


def arm_share_mm(record: ArmCalibration | None) -> float:
    """Return the arm's contribution to the frame's error on the flange, 3-D in mm; it cannot be measured.

    It stems from the last two links: A6 turns them against each other too little to separate them from the
    frame.
    """
    link_mm = np.sqrt(3.0) * LINK_TRANSLATION_MM if record is None else record.stated_error_mm
    return float(np.sqrt(2.0) * link_mm)


def _require_at_rest(returns: Sequence[FrameLook]) -> None:
    """Raise CAL-002 for fewer than two measurements at the first pose, CAL-016 if they disagree."""
    if len(returns) < 2:
        raise TOO_FEW_POSES(
            "the arm did not return to its first pose, so tracker stability is unknown",
            expected="at least 2 measurements from there",
            got=str(len(returns)),
        )
    for (number, before), (later, after) in combinations(enumerate(returns, start=1), 2):
        was, now = (one.tracker_from_marker.transform(Frame.TRACKER, Frame.MARKER) for one in (before, after))
        moved_mm, moved_rad = _change(was, now, limited=False)
        if moved_mm > MOVED_MM or moved_rad > MOVED_RAD:
            raise TRACKER_MOVED(
                f"tracker, arm or frame moved between measurements {number} and {later} at the first pose",
                limit=f"{MOVED_MM:g} mm and {np.degrees(MOVED_RAD):.1f} deg",
                got=f"{format_against_limit(moved_mm, MOVED_MM, 2)} mm and "
                f"{format_against_limit(math.degrees(moved_rad), math.degrees(MOVED_RAD), 2)} deg",
            )


def _validate(fit: HandEye, validation_pairs: PosePairs) -> tuple[Array, tuple[float, float]]:
    """Return misses (m, 6) of held-out measurements and their expected size. Raises CAL-002, CAL-004."""
    require_count(validation_pairs.count, LEAST_VALIDATION, "too few poses to validate the reference frame")
    misses = misses_of(validation_pairs, fit.flange_from_marker, fit.robot_from_tracker)
    slopes = slopes_of(validation_pairs, fit.flange_from_marker, fit.robot_from_tracker)
    random = np.diag([fit.scatter_mm**2] * 3 + [fit.scatter_rad**2] * 3)
    covariances = propagate(slopes, fit.covariance) + random
    statistic = float(np.einsum("mi,mi->", misses, np.linalg.solve(covariances, misses[..., None])[..., 0]))
    limit = float(chdtri(6 * validation_pairs.count, ACCEPTED)) * (1.0 + MODEL_SHARE)
    if statistic > limit:
        got, refused_from = format_distinct(statistic, limit, 0)
        raise DoesNotFit(
            "the frame does not agree with the poses kept for validation",
            limit=f"chi-square {refused_from}",
            got=f"{got}: {rms_mm(misses[:, :3]):.2f} mm",
        )
    variances = np.einsum("mii->mi", covariances)
    mm, rad = (float(np.sqrt(np.mean(variances[:, part].sum(axis=1)))) for part in (slice(3), slice(3, 6)))
    return misses, (mm, rad)


def _change(before: Transform, after: Transform, *, limited: bool = True) -> tuple[float, float]:
    """Return the change between two poses in mm and rad; raise CAL-017 if `limited` and too large."""
    apart_mm = float(np.linalg.norm(after.translation_mm - before.translation_mm))
    apart_rad = float((before.rigid.rotation.inv() * after.rigid.rotation).magnitude())
    if limited and (apart_mm > FAR_MM or apart_rad > FAR_RAD):
        raise FAR_FROM_RECORD(
            "the reference frame is not at its recorded pose",
            limit=f"{FAR_MM:g} mm and {np.degrees(FAR_RAD):.0f} deg",
            got=f"{format_against_limit(apart_mm, FAR_MM, 1)} mm and "
            f"{format_against_limit(math.degrees(apart_rad), math.degrees(FAR_RAD), 1)} deg",
        )
    return apart_mm, apart_rad


def frame_poses(reference: Transform, tool_from_marker: Transform, count: int) -> tuple[PlannedLook, ...]:
    """Plan poses ROBOT <- TOOL around a reference pose, each similar in orientation to the previous one."""
    in_tool = tool_from_marker.translation_mm
    place = reference.apply(in_tool)
    looks = plan_poses_about(
        reference.rigid.rotation, place, count, tilt_rad=TILT_RAD, turn_rad=TURN_RAD, offset_mm=in_tool
    )
    return tuple(order_by_orientation(looks))
