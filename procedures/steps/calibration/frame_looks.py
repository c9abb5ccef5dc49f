"""Rotation of the reference frame about its own position, in view of the tracker."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from pydantic import Field

from procedures.calibration.errors import POSES_OUT_OF_REACH, TOO_FEW_POSES
from procedures.calibration.frame_calibration import (
    TILT_RAD,
    FrameLook,
    FrameLooks,
    Use,
    assign_uses,
    frame_poses,
)
from procedures.calibration.hand_eye import LEAST_LOOKS
from procedures.calibration.head_model import pose_record
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.steps.calibration.ball_place import measuring_step, reachable_joints
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.ball_watcher import build_free_surroundings
from procedures.workcell.tracker_look import average_pose, read_frames_at_rest
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame
from ronna_hw.vectors import JointVector

SPARE = 1.5  # planned poses for each wanted one: from some the tracker does not see the frame
RETURN_AFTER = 10  # looks, then one at home to notice any move


class ObservedFrame(StepResult, kind="frame_looks"):
    """Looks used to calibrate the reference frame."""

    observed: FrameLooks = Field(description="Contents of `frame-looks.json`.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


def _turn_frame(context: StepContext, count: int, validation: int) -> Outcome[ObservedFrame]:
    """Rotate the frame and take the looks. Raises CAL-010, CAL-002, DEV-003, or PRO-002 unless confirmed."""
    context.result(CheckedSetUp)
    workcell, calibrations = context.workcell, context.workcell.calibrations
    plan = _reachable_turns(workcell, count + validation)
    uses = assign_uses(count, validation)
    total = len(uses)
    context.confirm(
        Topic.CALIBRATION,
        f"The arm will rotate the frame {calibrations.tracker_frame.tool} about its present "
        f"position, by up to {math.degrees(TILT_RAD):.0f} degrees in all directions, in {total} "
        "poses. Nobody and nothing else may be within its reach",
        f"{total} poses",
    )
    surroundings, tool = context.setting.surroundings, workcell.master.flange_from(MountedTool.STEREO_HEAD)
    workcell.master.surround(build_free_surroundings(surroundings, tool, surroundings.stereo_head))
    workcell.start()
    turning = _FrameRotation(context)
    turning.look_at(workcell.master.home_rad, Use.RETURN)
    for number, joints in enumerate(plan):
        if turning.taken == total:
            break
        turning.look_at(joints, uses[turning.taken])
        if number % RETURN_AFTER == RETURN_AFTER - 1:
            turning.look_at(workcell.master.home_rad, Use.RETURN)
        context.progress(turning.taken / total, "rotating the reference frame")
    turning.look_at(workcell.master.home_rad, Use.RETURN)
    if turning.taken < LEAST_LOOKS:
        raise TOO_FEW_POSES(
            "too few poses show the reference frame",
            expected=f"at least {LEAST_LOOKS}",
            got=f"{turning.taken} of {len(plan)}; {turning.why_rejected}",
            action="Clear the line of sight between tracker and frame, then calibrate again.",
        )
    observed = FrameLooks(
        created=context.setting.began,
        arm=workcell.master.arm.kinematics.name,
        stereo_head=calibrations.stereo_head,
        start=calibrations.tracker_frame,
        arm_record=calibrations.arm,
        looks=tuple(turning.looks),
    )
    missed = turning.rejected.total()
    remarks = (f"{missed} of {missed + turning.taken} poses not measured: {turning.why_rejected}",)
    return Outcome(
        ObservedFrame(observed=observed, remarks=remarks if turning.rejected else ()),
        f"{turning.taken} poses",
    )


def _reachable_turns(workcell: Workcell, wanted: int) -> Sequence[JointVector]:
    head = workcell.master.flange_from(MountedTool.STEREO_HEAD)
    frame = workcell.calibrations.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    reference = workcell.master.flange_pose(workcell.master.home_rad) @ head
    planned = frame_poses(reference, frame, round(SPARE * wanted))
    reached = [joints for look in planned if (joints := reachable_joints(workcell, look)) is not None]
    if len(reached) < wanted:
        raise POSES_OUT_OF_REACH(
            "too few poses of the reference frame are reachable",
            expected=f"{wanted} poses",
            got=f"{len(reached)} of {len(planned)}",
            action="Move the arm to where it can rotate the mount in all directions, then repeat.",
        )
    return reached


@dataclass
class _FrameRotation:
    """Rotation of the reference frame, with the looks taken so far."""

    context: StepContext
    looks: list[FrameLook] = field(default_factory=list)
    rejected: Counter[str] = field(default_factory=Counter)

    @property
    def taken(self) -> int:
        """Number of looks taken away from home."""
        return sum(one.use is not Use.RETURN for one in self.looks)

    @property
    def why_rejected(self) -> str:
        """Reasons for rejected poses, the most frequent first."""
        return ", ".join(f"{count} x {reason}" for reason, count in self.rejected.most_common(3))

    def look_at(self, joints: JointVector, use: Use) -> None:
        """Take a look from a pose, approached from the usual side; count an unusable pose as rejected."""
        workcell = self.context.workcell
        try:
            workcell.master.settle(joints, ONE_SIDE, allow_detour=True)
        except (LimitError, NotClear) as error:
            if workcell.master.arm.observe().state is not Lifecycle.ACTIVE:
                raise  # tripped, not refused before it began
            self.rejected[error.code] += 1
            return
        tool = workcell.calibrations.tracker_frame.tool
        frames, _ = read_frames_at_rest(workcell)
        try:
            seen = average_pose(frames, tool)
        except GateFailed as error:
            if use is Use.RETURN:
                raise  # from home, the frame must be in view
            self.rejected[error.what.partition(" is in ")[0] + " not in view"] += 1
            return
        measured = workcell.master.joints_rad()
        self.looks.append(
            FrameLook(
                use=use,
                joints_rad=measured,
                robot_from_flange=pose_record(workcell.master.flange_pose(measured)),
                tracker_from_marker=pose_record(seen),
                frames=len(frames),
            )
        )


def rotation_step(count: int, validation: int) -> StepSpec[ObservedFrame]:
    """Build the rotation step with `count` looks for the fit and `validation` looks for validation."""
    run = partial(_turn_frame, count=count, validation=validation)
    return measuring_step(ObservedFrame, "Rotate the reference frame in view of the tracker", run)
