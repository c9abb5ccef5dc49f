"""Bases of two arms: by the tracker, which sees the frames of both, then by the stereo head at a ball.

The assistant holds the ball where it will lead the instrument: above the entries. Once the bases are known,
both arms go home, where the tracker sees whether a platform has moved since.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.base_to_base import (
    LEAST_BALL_LOOKS,
    LEAST_FRAME_LOOKS,
    BallFit,
    BallLooks,
    BaseToBase,
    bases_by_frames,
    refine_bases,
)
from procedures.calibration.base_validity import MOVED_MM, platform_shift
from procedures.calibration.errors import DegeneratePoses, PlatformMoved, PosesOutOfReach
from procedures.calibration.hand_eye import PosePairs
from procedures.calibration.pose_set import PlannedLook, order_by_orientation, plan_poses_about
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.question import Topic
from procedures.planning.guide import depth_stop_mm
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.surroundings import READS, planning_scene_of, surround_stereo_head
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool
from procedures.workcell.assistant import Assistant
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import NotClear
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.calibration import Numbers3
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.strays import average_strays
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

FRAMES = 12  # of the tracker, averaged per look at a frame
FRAME_LOOKS, SPARE = 12, 12  # planned poses for each wanted one: an arm hides its own frame in most of them
MOST_FACING_RAD = math.radians(35.0)  # turn of the assistant's frame towards the tracker
FRAME_TILT_RAD, FRAME_TURN_RAD = math.radians(30.0), math.radians(60.0)
# Of the region where both frames are seen, from the middle of the entries, along the axes of the robot:
# between the arms, clear of the one that rests at home.
FRAMES_FROM_ENTRY_MM = (0.0, -200.0, 300.0)
BALL_ABOVE_GUIDE_MM = 80.0
BALL_SPREAD_MM = np.array((60.0, 60.0, 50.0))  # either way, of the ball's places
PLACES_SEED = 49
POSTURES, LOOKS_PER_POSTURE = 6, 3
MOST_POSTURES, LOOKS_TRIED = 48, 6  # that are tried: an arm stands in the way of the other in many
BALL_TILT_RAD, BALL_TURN_RAD = math.radians(35.0), math.radians(60.0)
HEAD_TILT_RAD, HEAD_TURN_RAD = math.radians(22.0), math.radians(50.0)
ENOUGH_MM = 0.095  # stated error at which no more looks are taken
# With the master home only, its frame and the spheres on the head show how the tracker stands; a shift of the
# assistant counts from 0.2 mm on, or from three standard errors where these places show less.
LEAST_SPREAD_MM, MOST_UNCERTAIN_MM, SIGMAS = 20.0, 0.4, 3.0
SAME_SPHERE_MM = 8.0  # from one reading to the next
FLANGE_ONWARDS = Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # instrument down


class KnownBases(StepResult, kind="base_to_base"):
    """Pose of the assistant's base relative to the master's, with its uncertainty."""

    robot_from_base: FramedPose = Field(description="Pose robot <- base of the assistant.")
    robot_from_tracker: FramedPose = Field(description="Pose robot <- tracker, by the master's turned frame.")
    flange_from_frame: FramedPose = Field(description="Pose flange <- frame of the assistant, as found.")
    by_frames_mm: float = Field(description="Standard error by the tracker alone, 3-D, where the ball was.")
    error_mm: float = Field(description="The same after the looks at the ball.")
    apart_mm: float = Field(description="How far tracker and stereo head disagree there.")
    scatter_mm: float = Field(description="Of the looks at the ball, per axis.")
    frame_looks: tuple[int, int] = Field(description="Looks at the frames of master and assistant.")
    ball_looks: int = Field(description="Looks at the ball.")
    outliers: int = Field(description="Of these, those left out.")
    flange_from_ball_mm: Numbers3 = Field(description="The ball on the assistant's flange, as found.")
    head_shift_mm: Numbers3 = Field(description="Stereo head beside its record, tool frame.")
    region_mm: Numbers3 = Field(description="Middle of the looks at the ball, robot frame.")
    master_seen_mm: tuple[Numbers3, ...] = Field(
        description="Frame on the arm and spheres, both arms home, tracker frame."
    )
    assistant_seen_mm: Numbers3 = Field(description="Frame of the assistant at home, tracker frame.")


def run(context: StepContext) -> Outcome[KnownBases]:
    """Find the bases. Raises CAL-002 to CAL-004, CAL-010, CAL-015, CAL-022, PRO-002, and as `check_room`."""
    workcell, second = context.workcell, context.workcell.second
    assert second is not None, "this step belongs to a case with two arms"
    workcell.mount.check(MountedTool.STEREO_HEAD)
    check_room(context, "before the arms are measured against each other")
    context.confirm(
        Topic.CALIBRATION,
        "Both arms will move, one at a time, each in view of the tracker, then both at a ball above the "
        "head. Nobody and nothing else may be within their reach",
        f"{2 * FRAME_LOOKS} looks at frames, {POSTURES * LOOKS_PER_POSTURE} at the ball",
    )
    measuring = _BaseMeasurement(context, second)
    workcell.place_assistant(measuring.first_guess())
    surround_stereo_head(context, workcell.joints_rad())
    workcell.start(cameras=True)
    workcell.surround_assistant(measuring.around())
    master, assistant = measuring.look_at_frames()
    records = workcell.calibrations
    assert records.arm is not None
    assert records.assistant_arm is not None
    errors_mm = (records.arm.stated_error_mm, records.assistant_arm.stated_error_mm)
    by_frames = bases_by_frames(master, assistant, errors_mm)
    coarse = by_frames.bases
    workcell.place_assistant(_robot_from_base(coarse))
    workcell.surround_assistant(measuring.around())
    fit = measuring.look_at_ball(coarse, ErrorSizes.stated(context.setting.settings, records.arm).tool_mm)
    workcell.place_assistant(_robot_from_base(fit.bases))
    second.shift_tool(_numbers(fit.flange_from_ball_mm))
    workcell.surround_assistant(measuring.around())
    seen = _see_platforms(context, second, context.result(GlobalLocalization).points_mm)
    there_mm = _inverse(fit.bases.robot_from_base) @ np.array([*fit.region_mm, 1.0])
    apart_mm = float(np.linalg.norm((coarse.robot_from_base @ there_mm)[:3] - fit.region_mm))
    error_mm, by_frames_mm = fit.error_mm, coarse.error_mm(fit.region_mm)
    return Outcome(
        KnownBases(
            robot_from_base=FramedPose.of(_robot_from_base(fit.bases)),
            robot_from_tracker=FramedPose.of(_of_tracker(by_frames.robot_from_tracker)),
            flange_from_frame=FramedPose.of(_on_flange(by_frames.flange_from_frame)),
            by_frames_mm=by_frames_mm,
            error_mm=error_mm,
            apart_mm=apart_mm,
            scatter_mm=fit.scatter_mm,
            frame_looks=(master.count, assistant.count),
            ball_looks=len(fit.used),
            outliers=int((~fit.used).sum()),
            flange_from_ball_mm=_numbers(fit.flange_from_ball_mm),
            head_shift_mm=_numbers(fit.head_shift_mm),
            region_mm=_numbers(fit.region_mm),
            master_seen_mm=tuple(map(_numbers, seen[0])),
            assistant_seen_mm=_numbers(seen[1]),
        ),
        summary=f"bases within {error_mm:.2f} mm by {len(fit.used)} looks at the ball; "
        f"by the tracker within {by_frames_mm:.2f} mm, {apart_mm:.2f} mm from that",
    )


def require_platforms_unmoved(context: StepContext) -> None:
    """Require both platforms where they were measured, with both arms home. Raises CAL-023, PRO-007.

    If one has moved, the bases are void and everything is localized again.
    """
    second = context.workcell.second
    known = (
        None if second is None else context.result_among(KnownBases, lambda made: made[-1] if made else None)
    )
    if second is None or known is None:
        return
    before_mm = np.array(known.master_seen_mm)
    now_mm, assistant_mm = _see_platforms(context, second, before_mm)
    pairs = [
        (one, now_mm[nearest])
        for one in before_mm
        if math.dist(now_mm[nearest := int(np.argmin(np.linalg.norm(now_mm - one, axis=1)))], one)
        < SAME_SPHERE_MM
    ]
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
        raise moved


class _BaseMeasurement:
    """Looks at the frames of both arms and at the assistant's ball."""

    def __init__(self, context: StepContext, second: Assistant) -> None:
        self._context, self._second = context, second
        self._cell, self._clock = context.workcell, context.setting.clock
        robot_from_ct = context.result(Correspondence).robot_from_ct.transform
        plan = context.result(CheckedPlan)
        entries, tops = [], []
        for name in context.result(CheckedPaths).targets:
            planned = plan.trajectory(name)
            entry, target = robot_from_ct.apply([planned.entry_mm, planned.target_mm])
            outwards = (entry - target) / np.linalg.norm(entry - target)
            stop_mm = depth_stop_mm(plan.plan, planned, self._cell.tools.guide.bore)
            entries.append(entry)
            tops.append(target + stop_mm * outwards)
        self._frames_mm = np.mean(entries, axis=0) + FRAMES_FROM_ENTRY_MM
        self._ball_mm = np.mean(tops, axis=0) + BALL_ABOVE_GUIDE_MM * np.array((0.0, 0.0, 1.0))

    def around(self) -> Surroundings:
        """Return what surrounds both arms besides themselves, robot frame."""
        cell = self._cell
        robot_from_ct = self._context.result(Correspondence).robot_from_ct.transform
        head = cell.flange_from(MountedTool.STEREO_HEAD)
        return planning_scene_of(self._context).with_stereo_head(robot_from_ct, head, None)

    def first_guess(self) -> Transform:
        """Return the base by one look at both frames at home, the assistant's as drawn."""
        frames = self._read(CAREFUL_FRAMES)
        on_master, on_assistant = self._cell.calibrations.tracker_frame.tool, self._second.holder.frame
        seen = [mean_pose(frames, name, CAREFUL_FRAMES // 2) for name in (on_master, on_assistant)]
        master, assistant = seen
        if master is None or assistant is None:
            name = on_master if master is None else on_assistant
            raise GateFailed(
                f"the tracker does not see the frame {name}",
                expected="both arms home, their frames in view",
                action="Clear the line of sight between tracker and both arms, then repeat the step.",
            )
        flange = self._second.flange_pose(self._second.joints_rad())
        drawn = self._second.holder.flange_from_frame.transform(Frame.FLANGE, Frame.MARKER)
        by_master = robot_from_marker(self._cell, self._cell.joints_rad()) @ master.inverse()
        return _between_bases((by_master @ assistant @ (flange @ drawn).inverse()).as_matrix())

    def look_at_frames(self) -> tuple[PosePairs, PosePairs]:
        """Turn the frame of each arm in the region, the other arm at home. Raises CAL-010."""
        cell, second = self._cell, self._second
        frame = cell.calibrations.tracker_frame
        marker_mm = frame.tool_from_marker.translation_mm
        reference = cell.tool_pose(cell.home_rad).rigid.rotation
        tracker = self._context.result(GlobalLocalization).robot_from_tracker.transform
        found = self._turn(
            (
                partial(cell.joints_at, one.pose, cell.home_rad, ONE_SIDE)
                for one in _plan_turns(reference, self._frames_mm, marker_mm)
            ),
            lambda at: explain_hidden_frame(tracker, robot_from_marker(cell, at), cell.arm.kinematics, at),
            lambda joints: cell.settle(joints, ONE_SIDE, allow_detour=True),
            lambda: cell.flange_pose(cell.joints_rad()),
            frame.tool,
        )
        cell.return_home()
        base = self._base()
        drawn = second.holder.flange_from_frame.transform(Frame.FLANGE, Frame.MARKER)
        frames_mm, from_base = base.inverse().apply(self._frames_mm), base.inverse() @ tracker
        home = second.flange_pose(second.home_rad).rigid.rotation
        facing = (home * drawn.rigid.rotation).as_matrix()[:, 2]
        towards = _turn_towards(facing, from_base.translation_mm - frames_mm) * home
        other = self._turn(
            (
                partial(second.flange_joints, _flange(one.pose), second.home_rad, ONE_SIDE)
                for one in _plan_turns(towards, frames_mm, drawn.translation_mm)
            ),
            lambda at: explain_hidden_frame(
                from_base, second.flange_pose(at) @ drawn, second.arm.kinematics, at
            ),
            second.settle,
            lambda: second.flange_pose(second.joints_rad(), ONE_SIDE),
            second.holder.frame,
        )
        second.go_home()
        return found, other

    def _turn(
        self,
        plan: Iterator[Callable[[], JointVector]],
        explain_hidden: Callable[[JointVector], str],
        settle: Callable[[JointVector], object],
        flange: Callable[[], Transform],
        frame: str,
    ) -> PosePairs:
        flanges: list[Array] = []
        seen: list[Array] = []
        reasons: list[str] = []
        for wanted in plan:
            if len(seen) == FRAME_LOOKS:
                break
            if not self._reach(wanted, settle, reasons, explain_hidden):
                continue
            pose = mean_pose(self._read(FRAMES), frame, FRAMES // 2)
            if pose is None:
                reasons.append(f"{frame} not in view")
                continue
            flanges.append(flange().as_matrix())
            seen.append(pose.as_matrix())
            self._context.progress(len(seen) / FRAME_LOOKS / 4.0, f"turning the frame {frame}")
        if len(seen) < LEAST_FRAME_LOOKS:
            raise PosesOutOfReach(
                f"too few poses show the frame {frame}",
                expected=f"{LEAST_FRAME_LOOKS}",
                got=f"{len(seen)}; {', '.join(sorted(set(reasons)))}",
            )
        return PosePairs(np.array(flanges), np.array(seen))

    def look_at_ball(self, coarse: BaseToBase, head_error_mm: float) -> BallFit:
        """Look at the ball until the bases are known. Raises CAL-003, CAL-004, CAL-010, CAL-022."""
        cell, second = self._cell, self._second
        ball_mm = second.holder.flange_from_ball_mm
        base = self._base()
        cell.sensors.read_around_tool(self._context.setting.settings.servo_area_px)
        planned = [
            plan_poses_about(
                FLANGE_ONWARDS,
                base.inverse().apply(self._ball_mm + beside_mm),
                1,
                number,
                tilt_rad=BALL_TILT_RAD,
                turn_rad=BALL_TURN_RAD,
                offset_mm=ball_mm,
            )[0]
            for number, beside_mm in enumerate(spread_places(MOST_POSTURES))
        ]
        sets = (planned[first : first + POSTURES] for first in range(0, MOST_POSTURES, POSTURES))
        postures = [posture for one in sets for posture in order_by_orientation(one)]
        reference = cell.tool_pose(cell.home_rad).rigid.rotation
        near = working_joints(second, [_flange(one.pose) for one in postures])
        heads: list[Array] = []
        places, flanges = [], []
        reasons: list[str] = []
        fit: BallFit | None = None
        held = 0
        for number, posture in enumerate(postures):
            wanted = partial(second.flange_joints, _flange(posture.pose), near, ONE_SIDE)
            if not self._reach(wanted, second.settle, reasons):
                continue
            flange = second.flange_pose(second.joints_rad(), ONE_SIDE)
            there_mm = (base @ flange).apply(ball_mm)
            looks = plan_poses_about(
                reference,
                there_mm,
                LOOKS_TRIED,
                number * LOOKS_TRIED,
                tilt_rad=HEAD_TILT_RAD,
                turn_rad=HEAD_TURN_RAD,
            )
            before = len(heads)
            for look in looks:
                if len(heads) == before + LOOKS_PER_POSTURE:
                    break
                at = partial(cell.joints_at, look.pose, cell.home_rad, ONE_SIDE)
                if not self._reach(
                    at, lambda joints: cell.settle(joints, ONE_SIDE, allow_detour=True), reasons
                ):
                    continue
                seen = cell.look()
                if seen.point is None:
                    reasons.append(seen.reason)
                    continue
                heads.append(cell.tool_pose(arrived=ONE_SIDE).as_matrix())
                places.append(seen.point.position_mm)
                flanges.append(flange.as_matrix())
            held += len(heads) > before
            share = 0.5 + min(held / POSTURES, 1.0) / 2.0
            self._context.progress(share, "looking at the ball")
            if held >= POSTURES:
                with suppress(DegeneratePoses):
                    fit = refine_bases(
                        coarse,
                        BallLooks(np.array(heads), np.array(places), np.array(flanges)),
                        ball_mm,
                        head_error_mm,
                    )
                if fit is not None and fit.error_mm <= ENOUGH_MM:
                    break
        if fit is None:
            if len(heads) < LEAST_BALL_LOOKS:
                raise PosesOutOfReach(
                    "too few looks at the ball of the assistant",
                    expected=f"{POSTURES * LOOKS_PER_POSTURE}",
                    got=f"{len(heads)}; {', '.join(sorted(set(reasons)))}",
                )
            looks_taken = BallLooks(np.array(heads), np.array(places), np.array(flanges))
            fit = refine_bases(coarse, looks_taken, ball_mm, head_error_mm)
        cell.return_home()
        second.go_home()
        return fit

    def _reach(
        self,
        wanted: Callable[[], JointVector],
        settle: Callable[[JointVector], object],
        reasons: list[str],
        explain_hidden: Callable[[JointVector], str] = lambda _joints: "",
    ) -> bool:
        """Move there unless it is of no use; return whether it was possible. Raises what trips an arm."""
        try:
            joints_rad = wanted()
            if explain_hidden(joints_rad):
                reasons.append("hidden from the tracker")
                return False
            settle(joints_rad)
        except (LimitError, NotClear) as error:
            if Lifecycle.FAULT in (self._cell.arm.state, self._second.arm.state):
                raise
            reasons.append(f"{error.code} ({error.meaning})")
            return False
        return True

    def _read(self, count: int) -> list[TrackerFrame]:
        return read_frames_at_rest(self._cell.tracker, self._clock, count=count)[0]

    def _base(self) -> Transform:
        assert self._second.base is not None
        return self._second.base


def _plan_turns(reference: Rotation, place_mm: ArrayLike, frame_mm: ArrayLike) -> list[PlannedLook]:
    """Plan turns of a frame at a place; each set of `FRAME_LOOKS` is spread evenly and ordered by itself."""
    sets = (
        plan_poses_about(
            reference,
            place_mm,
            FRAME_LOOKS,
            number * FRAME_LOOKS,
            tilt_rad=FRAME_TILT_RAD,
            turn_rad=FRAME_TURN_RAD,
            offset_mm=frame_mm,
        )
        for number in range(SPARE)
    )
    return [look for one in sets for look in order_by_orientation(one)]


def _turn_towards(facing: ArrayLike, wanted: ArrayLike) -> Rotation:
    """Return the turn of a direction (3,) towards another, by `MOST_FACING_RAD` at most."""
    one, other = (np.asarray(way, dtype=float) / np.linalg.norm(way) for way in (facing, wanted))
    axis = np.cross(one, other)
    sine = float(np.linalg.norm(axis))
    if not sine:
        return Rotation.identity()
    angle_rad = math.atan2(sine, float(one @ other))
    return Rotation.from_rotvec(axis / sine * min(angle_rad, MOST_FACING_RAD))


def spread_places(count: int) -> Array:
    """Return places (count, 3) spread about the middle: at one place, a turn of the base would not show."""
    draws = np.random.default_rng(PLACES_SEED)
    return np.asarray(draws.uniform(-1.0, 1.0, (count, 3)) * BALL_SPREAD_MM)


def working_joints(second: Assistant, flanges: Sequence[Transform]) -> JointVector:
    """Return joints in the branch in which the assistant reaches most of these poses of its flange."""
    one, two, three, four, five, six = second.home_rad

    def reached(near: JointVector) -> int:
        count = 0
        for flange in flanges:
            with suppress(LimitError):
                second.flange_joints(flange, near)
                count += 1
        return count

    return max((second.home_rad, (one, two, three, four, -five, six)), key=reached)


def _see_platforms(context: StepContext, second: Assistant, spheres_mm: object) -> tuple[Array, Array]:
    """Return the frame on the master with the known spheres (k, 3), and the assistant's frame, tracker frame.

    Both arms are home. Raises PRO-007 if a frame is not in view.
    """
    workcell = context.workcell
    frames, _ = read_frames_at_rest(workcell.tracker, context.setting.clock, count=CAREFUL_FRAMES)
    on_master = workcell.calibrations.tracker_frame.tool
    poses = {name: mean_pose(frames, name, CAREFUL_FRAMES // 2) for name in (on_master, second.holder.frame)}
    if hidden := [name for name, pose in poses.items() if pose is None]:
        raise GateFailed(
            f"with both arms home, the tracker does not see the frame {hidden[0]}",
            action="Clear the line of sight between tracker and both arms, then repeat the step.",
        )
    master, assistant = poses[on_master], poses[second.holder.frame]
    assert master is not None
    assert assistant is not None
    expected = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
    strays = np.array([group.mean_mm for group in average_strays(frames).groups]).reshape(-1, 3)
    known = [one for one in strays if np.linalg.norm(expected - one, axis=1).min() < SAME_SPHERE_MM]
    markers = master.apply(workcell.tracker.markers_mm[on_master])
    return np.vstack([markers, *known]), assistant.translation_mm


def _flange(pose: Transform) -> Transform:
    return Transform(Frame.ROBOT, Frame.FLANGE, pose.rigid)


def _robot_from_base(bases: BaseToBase) -> Transform:
    return _between_bases(bases.robot_from_base)


def _between_bases(matrix: Array) -> Transform:
    """Return ROBOT <- base of the assistant; both are bases of arms, so both have that frame."""
    return Transform(Frame.ROBOT, Frame.ROBOT, RigidTransform.from_matrix(np.asarray(matrix, dtype=float)))


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
    asks=(Topic.CALIBRATION,),
    reads=(CheckedPaths, *ROOM_READS, *READS),
    moves=True,
    relates_arms=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
