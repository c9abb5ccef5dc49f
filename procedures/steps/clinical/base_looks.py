"""Looks at two arms for their bases: by the tracker at both frames, by the stereo head at a ball.

One arm moves at a time, and only where the other leaves it a way; what is out of reach or hidden is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

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
    flange_of,
    plan_ball_postures,
    plan_turns,
    turn_towards,
    working_joints,
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
BALL_ABOVE_GUIDE_MM = 80.0
LOOKS_PER_POSTURE = 3
LOOKS_TRIED = 6  # for a posture: an arm stands in the way of the other in many
HEAD_TILT_RAD, HEAD_TURN_RAD = math.radians(22.0), math.radians(50.0)
ENOUGH_MM = 0.095  # stated error at which no more looks are taken


class BaseMeasurement:
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
        return between_bases((by_master @ assistant @ (flange @ drawn).inverse()).as_matrix())

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
                for one in plan_turns(reference, self._frames_mm, marker_mm)
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
        towards = turn_towards(facing, from_base.translation_mm - frames_mm) * home
        other = self._turn(
            (
                partial(second.flange_joints, flange_of(one.pose), second.home_rad, ONE_SIDE)
                for one in plan_turns(towards, frames_mm, drawn.translation_mm)
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
        postures = plan_ball_postures(base, self._ball_mm, ball_mm)
        reference = cell.tool_pose(cell.home_rad).rigid.rotation
        near = working_joints(second, postures)
        heads: list[Array] = []
        places, flanges = [], []
        reasons: list[str] = []
        fit: BallFit | None = None
        held = 0
        for number, posture in enumerate(postures):
            wanted = partial(second.flange_joints, posture, near, ONE_SIDE)
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


def between_bases(matrix: Array) -> Transform:
    """Return ROBOT <- base of the assistant; both are bases of arms, so both have that frame."""
    return Transform(Frame.ROBOT, Frame.ROBOT, RigidTransform.from_matrix(np.asarray(matrix, dtype=float)))
