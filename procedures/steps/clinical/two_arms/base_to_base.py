"""Bases of two arms: by the tracker, which sees the frames of both, then by the stereo head at a ball.

The assistant holds the ball where it will lead the instrument: above the entries. Once the bases are known,
both arms go home, where the tracker sees whether a platform has moved since.
"""

from __future__ import annotations

import numpy as np

from procedures.calibration.base_to_base import bases_by_frames
from procedures.calibration.errors import PlatformMoved
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomWatch
from procedures.journal.results import FramedPose
from procedures.operator.question import Topic
from procedures.room.motion import Moved
from procedures.steps.clinical.localized_room import take_in_assistant
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.results import KnownBases
from procedures.steps.clinical.room import ROOM_READS, check_room, room_watch
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.clinical.two_arms.ball_looks import LOOKS_PER_POSTURE, BallWatch
from procedures.steps.clinical.two_arms.base_postures import FRAME_LOOKS, POSTURES
from procedures.steps.clinical.two_arms.base_visits import ArmVisits
from procedures.steps.clinical.two_arms.frame_looks import (
    FIRST_GUESS_MM,
    guess_base,
    look_at_frames,
    see_both_home,
)
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import vector3


def run(context: StepContext) -> Outcome[KnownBases]:
    """Find the bases. Raises CAL-002 to CAL-004, CAL-010, CAL-015, CAL-022, PRO-002, and as `check_room`."""
    workcell, assistant = context.workcell, context.workcell.assistant
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    context.request_instrument_removal()
    first_look = len(room_watch(context).looks)
    check_room(context, "before the arms are measured against each other")
    context.confirm(
        Topic.CALIBRATION,
        "Both arms will move, one at a time, each in view of the tracker, then both at a ball above the "
        "head. Nobody and nothing else may be within their reach",
        f"{2 * FRAME_LOOKS} looks at frames, {POSTURES * LOOKS_PER_POSTURE} at the ball",
    )
    visits = ArmVisits(context, assistant)
    bring_arms_home(visits)
    ball = BallWatch(visits)
    assistant.place_base(guess_base(visits), FIRST_GUESS_MM)
    surround_stereo_head(context, workcell.master.joints_rad())
    workcell.start(cameras=True)
    assistant.surround(visits.around())
    master_looks, assistant_looks = look_at_frames(visits)
    records = workcell.calibrations
    assert records.arm is not None
    assert records.assistant_arm is not None
    errors_mm = (records.arm.stated_error_mm, records.assistant_arm.stated_error_mm)
    by_frames = bases_by_frames(master_looks, assistant_looks, errors_mm)
    coarse = by_frames.bases
    assistant.place_base(Transform.from_matrix(Frame.ROBOT, Frame.ASSISTANT, coarse.robot_from_base))
    assistant.surround(visits.around())
    fit = ball.look(coarse)
    robot_from_base = Transform.from_matrix(Frame.ROBOT, Frame.ASSISTANT, fit.bases.robot_from_base)
    assistant.place_base(robot_from_base)
    assistant.surround(visits.around())
    see_both_home(workcell, visits.read(CAREFUL_FRAMES))
    there_mm = np.linalg.inv(fit.bases.robot_from_base) @ np.array([*fit.region_mm, 1.0])
    apart_mm = float(np.linalg.norm((coarse.robot_from_base @ there_mm)[:3] - fit.region_mm))
    error_mm, by_frames_mm = fit.error_mm, coarse.error_mm(fit.region_mm)
    known = KnownBases(
        robot_from_base=FramedPose.of(robot_from_base),
        robot_from_tracker=_pose(Frame.ROBOT, Frame.TRACKER, by_frames.robot_from_tracker),
        flange_from_master_frame=_pose(Frame.FLANGE, Frame.MARKER, by_frames.flange_from_master_frame),
        flange_from_frame=_pose(Frame.FLANGE, Frame.MARKER, by_frames.flange_from_frame),
        by_frames_mm=by_frames_mm,
        error_mm=error_mm,
        apart_mm=apart_mm,
        scatter_mm=fit.scatter_mm,
        frame_looks=(master_looks.count, assistant_looks.count),
        ball_looks=len(fit.used),
        outliers=int((~fit.used).sum()),
        master_errors=fit.master.errors,
        assistant_errors=fit.assistant.errors,
        assistant_rad=ball.held_rad,
        region_mm=vector3(fit.region_mm),
        first_look=first_look,
    )
    _require_stood(context, known)
    return Outcome(
        known,
        summary=f"head and ball meet within {fit.meeting_mm:.2f} mm by {len(fit.used)} looks at the ball; "
        f"by the tracker within {by_frames_mm:.2f} mm, {apart_mm:.2f} mm from that",
    )


def _require_stood(context: StepContext, known: KnownBases) -> None:
    """Raise CAL-023 if the looks, with the bases known, show that something moved while they were taken."""
    workcell, settings = context.workcell, context.setting.settings
    motion = take_in_assistant(room_watch(context), workcell, settings, known)
    if motion is not None:
        if motion.moved is not Moved.ASSISTANT:  # the next look names it, and voids what depends on it
            check_room(context, "after the arms were measured against each other", CAREFUL_FRAMES)
        context.setting.memory.drop(RoomWatch)
        raise PlatformMoved(
            "a cart has moved while the arms were measured against each other",
            limit=f"{motion.limit_mm:.2f} mm",
            got=f"{format_against_limit(motion.moved_mm, motion.limit_mm, 2)} mm",
            action="Lock both carts, then repeat the step.",
        )


def bring_arms_home(visits: ArmVisits) -> None:
    """Bring home what a fault of an earlier attempt left away, the master first as after its looks."""
    cell, assistant = visits.cell, visits.assistant
    if assistant.history.base is None or not cell.is_any_arm_out:  # that attempt knew the bases
        return
    cell.assistant.place_base(assistant.base, assistant.history.base_uncertain_mm)
    surround_stereo_head(visits.context, cell.master.joints_rad())
    cell.start()
    cell.assistant.surround(visits.around())
    for arm in cell.arms.values():
        if arm.place.is_out:
            arm.return_home()


def _pose(target: Frame, source: Frame, matrix: Array) -> FramedPose:
    return FramedPose.of(Transform.from_matrix(target, source, matrix))


STEP = StepSpec(
    KnownBases,
    "Measure both arms against each other",
    Phase.PREPARATION,
    run,
    asks=(Topic.CALIBRATION, Topic.INSTRUMENT_OUT),
    reads=(CheckedPaths, *ROOM_READS, *READS),
    moves=True,
    relates_arms=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
