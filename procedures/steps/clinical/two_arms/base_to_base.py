"""Bases of two arms: by the tracker, which sees the frames of both, then by the stereo head at a ball.

The assistant holds the ball where it will lead the instrument: above the entries. Once the bases are known,
both arms go home, where the tracker sees whether a platform has moved since.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.calibration.arm_errors import FoundArm
from procedures.calibration.base_to_base import BaseToBase, bases_by_frames, meeting_error_mm
from procedures.calibration.base_validity import MOVED_MM, platform_shift
from procedures.calibration.errors import PlatformMoved
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose, Numbers6, StepResult
from procedures.operator.question import Topic
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.room import ROOM_READS, check_room, read_localized
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.clinical.two_arms.ball_looks import LOOKS_PER_POSTURE, BallWatch
from procedures.steps.clinical.two_arms.base_postures import FRAME_LOOKS, POSTURES
from procedures.steps.clinical.two_arms.base_visits import ArmVisits, between_bases, stated_arms
from procedures.steps.clinical.two_arms.frame_looks import FIRST_GUESS_MM, BaseFrameLooks, see_both_home
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.workcell import MountedTool
from ronna_hw.calibration import Numbers3
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit

Array = NDArray[np.float64]

# With the master home only, its frame and the spheres on the head show how the tracker stands; a shift of the
# assistant counts from 0.2 mm on, or from three standard errors where these places show less.
LEAST_SPREAD_MM, MOST_UNCERTAIN_MM, SIGMAS = 20.0, 0.4, 3.0
MEANWHILE_MM = 0.5  # of the assistant's frame at home, with the tracker's drift: three standard errors
SAME_SPHERE_MM = 8.0  # from one reading to the next
LEAST_PAIRS = 3  # for position and direction


class KnownBases(StepResult, kind="base_to_base"):
    """Pose of the assistant's base relative to the master's, with its uncertainty."""

    robot_from_base: FramedPose = Field(description="Pose robot <- base of the assistant.")
    robot_from_tracker: FramedPose = Field(description="Pose robot <- tracker, by the master's turned frame.")
    flange_from_master_frame: FramedPose = Field(description="Pose flange <- frame of the master, as found.")
    flange_from_frame: FramedPose = Field(description="Pose flange <- frame of the assistant, as found.")
    by_frames_mm: float = Field(description="Standard error by the tracker alone, 3-D, where the ball was.")
    error_mm: float = Field(
        description="Standard error, 3-D, with which head and ball meet there on average."
    )
    apart_mm: float = Field(description="How far tracker and stereo head disagree there.")
    scatter_mm: float = Field(description="Of the looks at the ball, per axis.")
    frame_looks: tuple[int, int] = Field(description="Looks at the frames of master and assistant.")
    ball_looks: int = Field(description="Looks at the ball.")
    outliers: int = Field(description="Of these, those left out.")
    master_errors: tuple[float, ...] = Field(description="Of the master, as found; see `FoundArm`.")
    assistant_errors: tuple[float, ...] = Field(description="The same of the assistant.")
    assistant_rad: Numbers6 = Field(description="Posture of the assistant in the last look.")
    region_mm: Numbers3 = Field(description="Middle of the looks at the ball, robot frame.")
    master_seen_mm: tuple[Numbers3, ...] = Field(
        description="Frame on the arm and spheres, both arms home, tracker frame."
    )
    assistant_seen_mm: Numbers3 = Field(description="Frame of the assistant at home, tracker frame.")

    @property
    def meeting_mm(self) -> float:
        """3-D standard error with which head and ball meet once, in a new posture."""
        return meeting_error_mm(self.error_mm, self.scatter_mm)


def found_arms(context: StepContext, known: KnownBases) -> tuple[FoundArm, FoundArm]:
    """Return master and assistant with their errors as found with the bases."""
    master, assistant = stated_arms(context)
    return FoundArm(master, known.master_errors), FoundArm(assistant, known.assistant_errors)


def run(context: StepContext) -> Outcome[KnownBases]:
    """Find the bases. Raises CAL-002 to CAL-004, CAL-010, CAL-015, CAL-022, PRO-002, and as `check_room`."""
    workcell, assistant = context.workcell, context.workcell.assistant
    assert assistant is not None, "this step belongs to a case with two arms"
    workcell.mount.check(MountedTool.STEREO_HEAD)
    context.request_instrument_removal()
    check_room(context, "before the arms are measured against each other")
    context.confirm(
        Topic.CALIBRATION,
        "Both arms will move, one at a time, each in view of the tracker, then both at a ball above the "
        "head. Nobody and nothing else may be within their reach",
        f"{2 * FRAME_LOOKS} looks at frames, {POSTURES * LOOKS_PER_POSTURE} at the ball",
    )
    visits = ArmVisits(context, assistant)
    bring_arms_home(visits)
    frames, ball = BaseFrameLooks(visits), BallWatch(visits)
    first_guess, seen_first_mm = frames.first_guess()
    workcell.place_assistant(first_guess, FIRST_GUESS_MM)
    surround_stereo_head(context, workcell.joints_rad())
    workcell.start(cameras=True)
    workcell.surround_assistant(visits.around())
    master_looks, assistant_looks = frames.look()
    records = workcell.calibrations
    assert records.arm is not None
    assert records.assistant_arm is not None
    errors_mm = (records.arm.stated_error_mm, records.assistant_arm.stated_error_mm)
    by_frames = bases_by_frames(master_looks, assistant_looks, errors_mm)
    coarse = by_frames.bases
    workcell.place_assistant(_robot_from_base(coarse))
    workcell.surround_assistant(visits.around())
    fit = ball.look(coarse)
    workcell.place_assistant(_robot_from_base(fit.bases))
    workcell.surround_assistant(visits.around())
    seen = _see_platforms(context, context.result(GlobalLocalization).points_mm)
    moved_mm = math.dist(seen[1], seen_first_mm)
    if moved_mm > MEANWHILE_MM:
        raise PlatformMoved(
            "a cart has moved while the arms were measured against each other",
            limit=f"{MEANWHILE_MM:g} mm",
            got=f"{format_against_limit(moved_mm, MEANWHILE_MM, 2)} mm",
            action="Lock both carts, then repeat the step.",
        )
    there_mm = _inverse(fit.bases.robot_from_base) @ np.array([*fit.region_mm, 1.0])
    apart_mm = float(np.linalg.norm((coarse.robot_from_base @ there_mm)[:3] - fit.region_mm))
    error_mm, by_frames_mm = fit.error_mm, coarse.error_mm(fit.region_mm)
    return Outcome(
        KnownBases(
            robot_from_base=FramedPose.of(_robot_from_base(fit.bases)),
            robot_from_tracker=FramedPose.of(_of_tracker(by_frames.robot_from_tracker)),
            flange_from_master_frame=FramedPose.of(_on_flange(by_frames.flange_from_master_frame)),
            flange_from_frame=FramedPose.of(_on_flange(by_frames.flange_from_frame)),
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
            region_mm=_numbers(fit.region_mm),
            master_seen_mm=tuple(map(_numbers, seen[0])),
            assistant_seen_mm=_numbers(seen[1]),
        ),
        summary=f"head and ball meet within {fit.meeting_mm:.2f} mm by {len(fit.used)} looks at the ball; "
        f"by the tracker within {by_frames_mm:.2f} mm, {apart_mm:.2f} mm from that",
    )


def bring_arms_home(visits: ArmVisits) -> None:
    """Bring home what a fault of an earlier attempt left away, the master first as after its looks."""
    cell, assistant = visits.cell, visits.assistant
    if assistant.history.base is None or not cell.is_any_arm_out:  # that attempt knew the bases
        return
    cell.place_assistant(assistant.base, assistant.history.base_uncertain_mm)
    surround_stereo_head(visits.context, cell.joints_rad())
    cell.start()
    cell.surround_assistant(visits.around())
    for arm in cell.supervised_arms:
        if arm.place.is_out:
            arm.return_home()


def require_platforms_unmoved(context: StepContext) -> None:
    """Require both platforms where they were measured, with both arms home. Raises CAL-023, PRO-007.

    If one has moved, the bases are void and everything is localized again.
    """
    assistant = context.workcell.assistant
    known = (
        None
        if assistant is None
        else context.result_among(KnownBases, lambda made: made[-1] if made else None)
    )
    if assistant is None or known is None:
        return
    if away := [arm.name for arm in context.workcell.supervised_arms if not arm.place.is_home]:
        raise GateFailed(
            "whether a platform has moved shows with both arms home",
            got=f"not home: {', '.join(away)}",
            action="Send the arms home, then repeat the step.",
        )
    before_mm = np.array(known.master_seen_mm)
    now_mm, assistant_mm = _see_platforms(context, before_mm)
    pairs = [
        (one, now_mm[nearest])
        for one in before_mm
        if math.dist(now_mm[nearest := int(np.argmin(np.linalg.norm(now_mm - one, axis=1)))], one)
        < SAME_SPHERE_MM
    ]
    if len(pairs) < LEAST_PAIRS:
        raise GateFailed(
            "too little of what showed how the tracker stands is where it was",
            expected=f"{LEAST_PAIRS} of {len(before_mm)} markers and spheres within {SAME_SPHERE_MM:g} mm",
            got=f"{len(pairs)}",
            action="Clear the line of sight; if the tracker, head or a cart was moved, localize again.",
        )
    master_before, master_now = (np.array(places) for places in zip(*pairs, strict=True))
    shift = platform_shift(
        master_before,
        master_now,
        np.array([known.assistant_seen_mm]),
        np.array([assistant_mm]),
        least_spread_mm=LEAST_SPREAD_MM,
        most_uncertain_mm=MOST_UNCERTAIN_MM,
    )
    limit_mm = max(MOVED_MM, SIGMAS * shift.error_mm)
    if shift.shift_mm > limit_mm:
        moved = PlatformMoved(
            "a platform has moved since the arms were measured against each other",
            limit=f"{limit_mm:.2g} mm",
            got=f"{format_against_limit(shift.shift_mm, limit_mm, 2)} mm",
        )
        context.void(GlobalLocalization, moved)
        seen_mm = assistant_mm - np.array(known.assistant_seen_mm)  # a pushed tracker is in it, and followed
        context.workcell.follow_assistant(known.robot_from_tracker.transform.rotation_matrix @ seen_mm)
        raise moved


def _see_platforms(context: StepContext, spheres_mm: object) -> tuple[Array, Array]:
    """Return the frame on the master with the known spheres (k, 3), and the assistant's frame, tracker frame.

    Both arms are home. Raises PRO-007 if a frame is not in view.
    """
    workcell = context.workcell
    frames = read_localized(context)
    master_frame, assistant_frame = see_both_home(workcell, frames)
    expected = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
    strays = np.array([group.mean_mm for group in average_strays(frames).groups]).reshape(-1, 3)
    known = [one for one in strays if np.linalg.norm(expected - one, axis=1).min() < SAME_SPHERE_MM]
    markers = master_frame.apply(workcell.tracker.markers_mm[workcell.calibrations.tracker_frame.tool])
    return np.vstack([markers, *known]), assistant_frame.translation_mm


def _robot_from_base(bases: BaseToBase) -> Transform:
    return between_bases(bases.robot_from_base)


def _on_flange(matrix: Array) -> Transform:
    return Transform(Frame.FLANGE, Frame.MARKER, RigidTransform.from_matrix(matrix))


def _of_tracker(matrix: Array) -> Transform:
    return Transform(Frame.ROBOT, Frame.TRACKER, RigidTransform.from_matrix(matrix))


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix))


def _numbers(values: object) -> Numbers3:
    x, y, z = np.asarray(values, dtype=float).tolist()
    return (x, y, z)


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
