"""Small head moves, measured by the tracker and followed by the registration if the operator agrees.

The arm is home, where the localization was made. There nothing hides the head, and the frame on the arm shows
a move of cart or tracker. Only a single rigid, small and completed move is followed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.engine.context import StepContext
from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.guards.room_motion import name_motion
from procedures.guards.room_watch import RoomWatch
from procedures.journal.errors import StepRefused
from procedures.journal.results import FramedPose
from procedures.registration.error_sources import HEAD_MOVE, STABILITY
from procedures.registration.movement import RigidMove, fit_rigid_move, identify_points, measure_shift
from procedures.room.motion import Moved
from procedures.steps.branches import FOLLOW, MOVE_FOLLOWED
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.localized_room import build_watch
from procedures.steps.clinical.results import FollowedMove
from procedures.steps.clinical.room import MOST_FOLLOWED_MM
from procedures.workcell.tracker_look import FRAMES, read_frames_at_rest
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_distinct

# Limits of a followed move, with `MOST_FOLLOWED_MM`: paths and angles were chosen for the head as it lay, and
# a clamp that let it go further is not trusted to hold it now.
# Safety against a registration that follows too large a move, or one not ended (U).
MOST_FOLLOWED_RAD = math.radians(2.0)
AT_REST_MM = 0.15  # between the halves of the reading: their noise is 0.05 mm

STEADY_MM = 0.03  # per axis: drift of the tracker between two readings of one place; an estimate


@dataclass(frozen=True)
class MeasuredMove:
    """A measured move and its fit, in the robot frame."""

    fit: RigidMove
    record: FollowedMove

    def shares_mm(self, place_mm: ArrayLike) -> dict[str, float]:
        """Return the errors by source that following adds at a point (3,) mm, robot frame before the move."""
        return {
            HEAD_MOVE: self.fit.error_mm(place_mm),
            STABILITY: self.record.base_mm,
        }


def followed_move(context: StepContext, places_mm: ArrayLike) -> MeasuredMove | None:
    """Measure the head's move and ask for consent to follow it; return None if the head has not moved.

    `places_mm` (n, 3) are the targets served, robot frame, before the move. Raises PRO-001 unless the arm is
    home, PRO-022, and, after voiding the localization, PRO-019 or PRO-020 for a move that is not followed.
    """
    try:
        move = _measure_move(context)
        if move is not None:
            _have_agreed(context, move, places_mm)
    except (BaseShifted, PatientMoved) as moved:
        context.setting.memory.drop(RoomWatch)
        context.void(GlobalLocalization, moved)
        raise
    return move


def _measure_move(context: StepContext) -> MeasuredMove | None:
    workcell = context.workcell
    if not workcell.master.place.is_home:
        raise StepRefused(
            f"the movement of the head can only be measured with {workcell.phrases.arms} at home",
            action=f"Send {workcell.phrases.arms} home, then run the step again.",
        )
    localized, pairs = context.result(GlobalLocalization), context.result(Correspondence).pairs
    settings, name = context.setting.settings, context.identifier(GlobalLocalization)
    watch = build_watch(workcell, settings, name, localized, pairs)
    context.progress(0.0, "measuring whether the head has moved")
    frames, _ = read_frames_at_rest(workcell)
    judged, pushed = watch.follow_tracker(watch.judge(watch.read(workcell, frames)))
    reading, motion, expected = judged.reading, judged.motion, watch.expected(judged)
    for finding in pushed:
        context.find(finding)
    frames = [watch.as_localized(frame) for frame in frames]
    if motion is None:
        return None
    if reading.on_arm is None:
        raise PatientUnseen(
            "the tracker does not see the frame on the arm: head and tracker movement cannot be told apart"
        )
    if motion.moved in (Moved.BASE, Moved.SEVERAL):  # the arm is not where it was, whatever else moved
        raise name_motion(motion, expected, reading)
    rows = identify_points(watch.spheres_mm, reading.spheres_mm)
    if rows is None:
        raise PatientUnseen("the tracker sees too few known spheres to measure the movement of the head")
    before, after = (list(side) for side in zip(*rows, strict=True))
    halves = (average_strays(half).groups for half in (frames[: FRAMES // 2], frames[FRAMES // 2 :]))
    ways = measure_shift(*([group.mean_mm for group in groups] for groups in halves))
    if ways is None or ways.rms_mm > AT_REST_MM:
        raise PatientUnseen("the head is not at rest: its movement cannot be measured")
    to_robot = watch.robot_from_tracker
    groups = average_strays(frames).groups
    each = np.array([groups[row].covariance_mm2 for row in after])
    counts = np.array([[1.0 / groups[row].count + 1.0 / localized.frames] for row in after])[:, :, None]
    turn = to_robot.rotation_matrix
    covariance = turn @ (each * counts) @ turn.T + np.eye(3) * STEADY_MM**2
    fit = fit_rigid_move(
        to_robot.apply(watch.spheres_mm[before]), to_robot.apply(reading.spheres_mm[after]), covariance
    )
    now = to_robot.inverse().apply(fit.fit.transform.apply(to_robot.apply(watch.spheres_mm)))
    now[before] = reading.spheres_mm[after]
    clamp = None if watch.clamp_mm is None else reading.on_clamp
    move = FollowedMove(
        robot_from_robot=FramedPose.of(Transform(Frame.ROBOT, Frame.ROBOT, fit.fit.transform)),
        way_mm=fit.way_mm,
        turn_deg=math.degrees(fit.turn_rad),
        pairs=fit.fit.pairs,
        residual_mm=float(fit.fit.fre_mm),
        limit_mm=fit.gate.limit_mm,
        base_mm=0.0 if expected.arm_way_mm is None else math.hypot(*expected.arm_way_mm),
        spheres_tracker_mm=tuple(now.tolist()),
        tracker_from_patient=None if clamp is None else FramedPose.of(clamp),
    )
    _require_followable(fit, move)
    return MeasuredMove(fit, move)


def _require_followable(fit: RigidMove, move: FollowedMove) -> None:
    if not fit.gate.passed:
        residual, limit = format_distinct(move.residual_mm, move.limit_mm, 2)
        raise PatientMoved(
            "the spheres on the head have not moved as a rigid body",
            limit=f"{limit} mm",
            got=f"{residual} mm",
        )
    if fit.rms_mm > MOST_FOLLOWED_MM or fit.turn_rad > MOST_FOLLOWED_RAD:
        raise PatientMoved(
            "the head has moved too far for the registration to follow",
            limit=f"{MOST_FOLLOWED_MM:g} mm, {math.degrees(MOST_FOLLOWED_RAD):g} deg",
            got=f"{fit.rms_mm:.2f} mm, {move.turn_deg:.2f} deg",
        )


def _have_agreed(context: StepContext, move: MeasuredMove, places_mm: ArrayLike) -> None:
    figures, names = move.record, " and ".join(context.served_trajectories)
    moved = f"{figures.way_mm:.2f} mm and {figures.turn_deg:.2f} deg"
    adds_mm = max(math.hypot(*move.shares_mm(place).values()) for place in np.reshape(places_mm, (-1, 3)))
    question = MOVE_FOLLOWED.question(
        f"the head has moved by {moved}: let the registration for {names} follow",
        f"{figures.pairs} spheres fit one rigid motion to {figures.residual_mm:.2f} mm, limit "
        f"{figures.limit_mm:.2f} mm; following adds {adds_mm:.2f} mm rms at the target",
        context.key.trajectory,
    )
    if context.choose(question) != FOLLOW:
        raise PatientMoved.from_shift(
            "the head has moved, and the registration was not updated", move.fit.rms_mm, move.record.limit_mm
        )
    context.find(f"the registration for {names} follows a head movement of {moved}")
