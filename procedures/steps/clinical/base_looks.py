"""Looks at two arms for their bases: by the tracker at both frames, by the stereo head at a ball.

One arm moves at a time, and only where the other leaves it a way; what is out of reach or hidden is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from procedures.calibration.arm_errors import StatedArm
from procedures.calibration.base_to_base import (
    LEAST_BALL_LOOKS,
    LEAST_FRAME_LOOKS,
    BallFit,
    BallLooks,
    BaseToBase,
    refine_bases,
)
from procedures.calibration.errors import DegeneratePoses, PosesOutOfReach
from procedures.calibration.hand_eye import PosePairs
from procedures.calibration.pose_set import plan_poses_about
from procedures.engine.context import StepContext
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.planning.guide import depth_stop_mm
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.base_postures import (
    FRAME_LOOKS,
    POSTURES,
    face_along,
    flange_of,
    order_by_travel,
    plan_ball_postures,
    plan_turns,
    turn_towards,
    turns_about_axis,
    working_joints,
    wrist_branches,
)
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.surroundings import planning_scene_of
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool
from procedures.workcell.assistant import Assistant
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import NotClear
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

FRAMES = 12  # of the tracker, averaged per look at a frame
# Of the region where both frames are seen, from the middle of the entries, along the axes of the robot:
# between the arms, clear of the one that rests at home.
FRAMES_FROM_ENTRY_MM = (0.0, -200.0, 300.0)
BALL_ABOVE_GUIDE_MM = 10.0  # higher, both arms would be in other postures than with the instrument
LEAST_POSTURES = 8  # 16 looks: the instrument is then 0.07 mm off the bore, 2-D, after twelve looks 0.09
LOOKS_PER_POSTURE = 2
LOOKS_TRIED = 6  # for a posture: an arm stands in the way of the other in many
HEAD_TILT_RAD, HEAD_TURN_RAD = math.radians(18.0), math.radians(40.0)
ENOUGH_MM = 0.08  # stated error at which no more looks are taken


class _Mover(NamedTuple):
    """One of the arms, as it is moved and read for a look."""

    joints_rad: Callable[[], JointVector]
    settle: Callable[[JointVector], object]
    flange: Callable[[], Transform]


class BaseMeasurement:
    """Looks at the frames of both arms and at the assistant's ball."""

    def __init__(self, context: StepContext, assistant: Assistant) -> None:
        self._context, self._assistant = context, assistant
        self._cell, self._clock = context.workcell, context.setting.clock
        robot_from_ct = context.result(Correspondence).robot_from_ct.transform
        plan = context.result(CheckedPlan)
        self.held_rad = assistant.home_rad  # of the assistant in the last look at its ball
        entries, tops, ways, axes = [], [], [], []
        for name in context.result(CheckedPaths).targets:
            planned = plan.trajectory(name)
            entry, target = robot_from_ct.apply([planned.entry_mm, planned.target_mm])
            outwards = (entry - target) / np.linalg.norm(entry - target)
            stop_mm = depth_stop_mm(plan.plan, planned, self._cell.tools.guide.bore)
            entries.append(entry)
            tops.append(target + stop_mm * outwards)
            ways.append(outwards)
            axes.append((tops[-1] + stop_mm * outwards, -outwards))
        self._axes = axes  # where the clamp begins to insert, and which way
        self._frames_mm = np.mean(entries, axis=0) + FRAMES_FROM_ENTRY_MM
        self._outwards = np.mean(ways, axis=0)
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
        on_master, on_assistant = self._cell.calibrations.tracker_frame.tool, self._assistant.holder.frame
        seen = [mean_pose(frames, name, CAREFUL_FRAMES // 2) for name in (on_master, on_assistant)]
        master, assistant = seen
        if master is None or assistant is None:
            name = on_master if master is None else on_assistant
            raise GateFailed(
                f"the tracker does not see the frame {name}",
                expected="both arms home, their frames in view",
                action="Clear the line of sight between tracker and both arms, then repeat the step.",
            )
        flange = self._assistant.flange_pose(self._assistant.joints_rad())
        by_master = robot_from_marker(self._cell, self._cell.joints_rad()) @ master.inverse()
        return between_bases((by_master @ assistant @ (flange @ self._drawn_frame).inverse()).as_matrix())

    def look_at_frames(self) -> tuple[PosePairs, PosePairs]:
        """Turn the frame of each arm in the region, the other arm at home. Raises CAL-010.

        The assistant stays there: it goes on to hold its ball.
        """
        cell, assistant = self._cell, self._assistant
        frame = cell.calibrations.tracker_frame
        marker_mm = frame.tool_from_marker.translation_mm
        reference = cell.tool_pose(cell.home_rad).rigid.rotation
        tracker = self._context.result(GlobalLocalization).robot_from_tracker.transform
        found = self._turn(
            (
                partial(cell.joints_at, one.pose, cell.home_rad, ONE_SIDE)
                for one in plan_turns(reference, self._frames_mm, marker_mm)
            ),
            lambda at: explain_hidden_frame(tracker, robot_from_marker(cell, at), cell.arm.kinematics, at),
            _Mover(
                cell.joints_rad,
                lambda joints: cell.settle(joints, ONE_SIDE, allow_detour=True),
                lambda: cell.flange_pose(cell.joints_rad()),
            ),
            frame.tool,
        )
        cell.return_home()
        drawn, from_base = self._drawn_frame, self._tracker_in_base()
        frames_mm = self._assistant.base.inverse().apply(self._frames_mm)
        home = assistant.flange_pose(assistant.home_rad).rigid.rotation
        facing = (home * drawn.rigid.rotation).as_matrix()[:, 2]
        towards = turn_towards(facing, from_base.translation_mm - frames_mm) * home
        turns = [flange_of(one.pose) for one in plan_turns(towards, frames_mm, drawn.translation_mm)]
        near = working_joints(assistant, turns[:FRAME_LOOKS])
        other = self._turn(
            (partial(assistant.flange_joints, one, near, ONE_SIDE) for one in turns),
            lambda at: explain_hidden_frame(
                from_base, assistant.flange_pose(at) @ drawn, assistant.arm.kinematics, at
            ),
            _Mover(
                assistant.joints_rad,
                assistant.settle,
                lambda: assistant.flange_pose(assistant.joints_rad(), ONE_SIDE),
            ),
            assistant.holder.frame,
        )
        return found, other

    def _turn(
        self,
        plan: Iterable[Callable[[], JointVector]],
        explain_hidden: Callable[[JointVector], str],
        arm: _Mover,
        frame: str,
    ) -> PosePairs:
        flanges: list[Array] = []
        seen: list[Array] = []
        reasons: list[str] = []
        for _ in self._visit(_list_possible(plan, reasons, explain_hidden), FRAME_LOOKS, arm, reasons):
            pose = mean_pose(self._read(FRAMES), frame, FRAMES // 2)
            if pose is None:
                reasons.append(f"{frame} not in view")
                continue
            flanges.append(arm.flange().as_matrix())
            seen.append(pose.as_matrix())
            self._context.progress(len(seen) / FRAME_LOOKS / 4.0, f"turning the frame {frame}")
            if len(seen) == FRAME_LOOKS:
                break
        if len(seen) < LEAST_FRAME_LOOKS:
            raise PosesOutOfReach(
                f"too few poses show the frame {frame}",
                expected=f"{LEAST_FRAME_LOOKS}",
                got=f"{len(seen)}; {', '.join(sorted(set(reasons)))}",
            )
        return PosePairs(np.array(flanges), np.array(seen))

    def look_at_ball(self, coarse: BaseToBase) -> BallFit:
        """Look at the ball until the bases are known. Raises CAL-003, CAL-004, CAL-010, CAL-022."""
        cell, assistant = self._cell, self._assistant
        ball_mm = assistant.holder.flange_from_ball_mm
        base = self._assistant.base
        cell.sensors.read_around_tool(self._context.setting.settings.servo_area_px)
        inwards = -base.inverse().rotation_matrix @ self._outwards
        reference = face_along(assistant.flange_from_clamp.rotation_matrix[:, 2], inwards)
        postures = plan_ball_postures(reference, base, self._ball_mm, ball_mm)
        near = self._wrist_over_guides(working_joints(assistant, postures))
        looks: list[tuple[Array, Array, Array, JointVector, JointVector]] = []
        reasons: list[str] = []
        held = 0

        def fit() -> BallFit:
            seen = BallLooks(*map(np.array, zip(*looks, strict=True)))
            return refine_bases(coarse, seen, ball_mm, assistant.ball_error_mm, *stated_arms(self._context))

        plan = (partial(assistant.flange_joints, one, near, ONE_SIDE) for one in postures)
        arm = _Mover(
            assistant.joints_rad,
            assistant.settle,
            lambda: assistant.flange_pose(assistant.joints_rad(), ONE_SIDE),
        )
        for _ in self._visit(_list_possible(plan, reasons), POSTURES, arm, reasons):
            flange, before = arm.flange(), len(looks)
            for pose, ball_in_head_mm in self._look_from_around(
                (base @ flange).apply(ball_mm), held, reasons
            ):
                joints_rad = cell.joints_rad(), assistant.joints_rad()
                self.held_rad = joints_rad[1]
                looks.append((pose.as_matrix(), ball_in_head_mm, flange.as_matrix(), *joints_rad))
            held += len(looks) > before
            share = 0.5 + min(held / POSTURES, 1.0) / 2.0
            self._context.progress(share, "looking at the ball")
            if len(looks) < LEAST_BALL_LOOKS or held < LEAST_POSTURES:
                continue
            with suppress(DegeneratePoses):
                if fit().error_mm <= ENOUGH_MM:
                    break
        if len(looks) < LEAST_BALL_LOOKS:
            raise PosesOutOfReach(
                "too few looks at the ball of the assistant",
                expected=f"{POSTURES * LOOKS_PER_POSTURE}",
                got=f"{len(looks)}; {', '.join(sorted(set(reasons)))}",
            )
        cell.return_home()
        assistant.return_home()
        return fit()

    def _wrist_over_guides(self, usual: JointVector) -> JointVector:
        """Return joints in the branch of the wrist in which the instrument will be inserted.

        That is the usual one unless it hides the assistant's frame from the tracker over a guide, and the
        other does not: in the branch of the looks, the errors of the arm are known.
        """
        branch_of = self._assistant.arm.kinematics.branch_of
        for near in sorted(
            wrist_branches(self._assistant), key=lambda one: branch_of(one) != branch_of(usual)
        ):
            if all(self._shows_frame(place_mm, inwards, near) for place_mm, inwards in self._axes):
                return near
        return usual

    def _shows_frame(self, place_mm: Array, inwards: Array, near: JointVector) -> bool:
        """Return whether the tracker sees the assistant's frame at some turn about an axis."""
        assistant, drawn = self._assistant, self._drawn_frame
        tracker = self._tracker_in_base()
        for turn in turns_about_axis(turn_towards((0.0, 0.0, 1.0), inwards, math.pi)):
            clamp = Transform(Frame.ROBOT, Frame.TOOL, RigidTransform.from_components(place_mm, turn))
            with suppress(LimitError):
                at = assistant.clamp_joints(clamp, near)
                marker = assistant.flange_pose(at) @ drawn
                if not explain_hidden_frame(tracker, marker, assistant.arm.kinematics, at):
                    return True
        return False

    @property
    def _drawn_frame(self) -> Transform:
        return self._assistant.holder.flange_from_frame.transform(Frame.FLANGE, Frame.MARKER)

    def _tracker_in_base(self) -> Transform:
        """Return the tracker in the base of the assistant."""
        tracker = self._context.result(GlobalLocalization).robot_from_tracker.transform
        return self._assistant.base.inverse() @ tracker

    def _look_from_around(
        self, ball_mm: Array, number: int, reasons: list[str]
    ) -> Iterator[tuple[Transform, Array]]:
        """Look at the ball where it is held; yield the pose ROBOT <- TOOL of the head and the ball in TOOL.

        Ways past the assistant are tried first, those via home only if none of them is clear.
        """
        cell, looks = self._cell, 0
        reference = cell.tool_pose(cell.home_rad).rigid.rotation
        around = plan_poses_about(
            reference,
            ball_mm,
            LOOKS_TRIED,
            number * LOOKS_TRIED,
            tilt_rad=HEAD_TILT_RAD,
            turn_rad=HEAD_TURN_RAD,
        )
        for allow_detour in (False, True):
            plan = (partial(cell.joints_at, one.pose, cell.home_rad, ONE_SIDE) for one in around)
            settle = partial(cell.settle, arriving=ONE_SIDE, allow_detour=allow_detour)
            arm = _Mover(cell.joints_rad, settle, lambda: cell.flange_pose(cell.joints_rad()))
            for _ in self._visit(_list_possible(plan, reasons), LOOKS_PER_POSTURE, arm, reasons):
                seen = cell.look()
                if seen.point is None:
                    reasons.append(seen.reason)
                    continue
                yield cell.tool_pose(arrived=ONE_SIDE), np.asarray(seen.point.position_mm)
                looks += 1
                if looks == LOOKS_PER_POSTURE:
                    return
            if looks:
                return

    def _visit(
        self, possible: Iterator[JointVector], at_once: int, arm: _Mover, reasons: list[str]
    ) -> Iterator[None]:
        """Move to postures, `at_once` of them ordered for a short way; yield after each arrival.

        Leaves out those that are not clear. Raises what trips an arm.
        """
        while batch := tuple(islice(possible, at_once)):
            for joints_rad in order_by_travel(arm.joints_rad(), batch):
                try:
                    arm.settle(joints_rad)
                except (LimitError, NotClear) as error:
                    if Lifecycle.FAULT in (self._cell.arm.state, self._assistant.arm.state):
                        raise
                    reasons.append(f"{error.code} ({error.meaning})")
                else:
                    yield

    def _read(self, count: int) -> list[TrackerFrame]:
        return read_frames_at_rest(self._cell.tracker, self._clock, count=count)[0]


def _list_possible(
    plan: Iterable[Callable[[], JointVector]],
    reasons: list[str],
    explain_hidden: Callable[[JointVector], str] = lambda _joints: "",
) -> Iterator[JointVector]:
    """Yield the planned joints that are in reach and, where that counts, in the tracker's view."""
    for wanted in plan:
        try:
            joints_rad = wanted()
        except LimitError as error:
            reasons.append(f"{error.code} ({error.meaning})")
            continue
        if explain_hidden(joints_rad):
            reasons.append("hidden from the tracker")
        else:
            yield joints_rad


def stated_arms(context: StepContext) -> tuple[StatedArm, StatedArm]:
    """Return master and assistant as their records state them."""
    workcell, records = context.workcell, context.workcell.calibrations
    assert workcell.assistant is not None
    arms = ((workcell.arm, records.arm), (workcell.assistant.arm, records.assistant_arm))
    master, assistant = (
        StatedArm(arm.kinematics.chain, ErrorSizes.stated(context.setting.settings, record))
        for arm, record in arms
    )
    return master, assistant


def between_bases(matrix: Array) -> Transform:
    """Return ROBOT <- base of the assistant; both are bases of arms, so both have that frame."""
    return Transform(Frame.ROBOT, Frame.ROBOT, RigidTransform.from_matrix(np.asarray(matrix, dtype=float)))
