"""Looks of the tracker at the frames of both arms, turned in one region: bases within half a millimetre."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from procedures.calibration.base_to_base import LEAST_FRAME_LOOKS
from procedures.calibration.errors import POSES_OUT_OF_REACH
from procedures.calibration.hand_eye import PosePairs
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.two_arms.base_postures import (
    FRAME_LOOKS,
    flange_of,
    plan_turns,
    turn_towards,
    working_joints,
)
from procedures.steps.clinical.two_arms.base_visits import ArmVisits, list_possible
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import Workcell
from procedures.workcell.supervised_arm import SupervisedArm
from procedures.workcell.tracker_look import mean_pose, robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.sensors import measuring_volume_mm
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

# Three sigma of the frame's turn on its flange (half a degree) over 0.7 m from home, and of its place (1 mm).
FIRST_GUESS_MM = 20.0
FRAMES = 12  # of the tracker, averaged per look at a frame
# Of the region where both frames are seen, from the middle of the entries, along the axes of the robot:
# between the arms, clear of the one that rests at home.
FROM_ENTRY_MM = (0.0, -200.0, 300.0)


def see_both_home(workcell: Workcell, frames: list[TrackerFrame]) -> list[Transform]:
    """Return the poses TRACKER <- MARKER of the frames on all arms. Raises PRO-007 for a hidden one."""
    poses = []
    for arm in workcell.arms.values():
        pose = mean_pose(frames, arm.frame, max(1, len(frames) // 2))
        if pose is None:
            raise GateFailed(
                f"with both arms home, the tracker does not see the frame {arm.frame}",
                action="Clear the line of sight between tracker and both arms, then repeat the step.",
            )
        poses.append(pose)
    return poses


def guess_base(visits: ArmVisits) -> Transform:
    """Return the base of the assistant by one look at both frames at home, its own taken as drawn."""
    cell, assistant = visits.cell, visits.assistant
    on_master, on_assistant = see_both_home(cell, visits.read(CAREFUL_FRAMES))
    flange = assistant.flange_pose(assistant.joints_rad())
    by_master = robot_from_marker(cell, cell.master.joints_rad()) @ on_master.inverse()
    base = by_master @ on_assistant @ (flange @ visits.drawn_frame).inverse()
    return Transform.from_matrix(Frame.ROBOT, Frame.ASSISTANT, base.as_matrix())


def look_at_frames(visits: ArmVisits) -> tuple[PosePairs, PosePairs]:
    """Turn the frame of each arm in the region, the other arm at home. Raises CAL-010.

    The assistant stays there: it goes on to hold its ball.
    """
    master, assistant = visits.cell.master, visits.assistant
    region_mm = np.mean([one.entry_mm for one in visits.planned_guides()], axis=0) + FROM_ENTRY_MM
    marker_mm = visits.cell.calibrations.tracker_frame.tool_from_marker.translation_mm
    reference = master.tool_pose(master.home_rad).rigid.rotation
    tracker = visits.context.result(GlobalLocalization).robot_from_tracker.transform
    volume_mm = measuring_volume_mm(visits.cell.tracker)

    def explain_hidden(at_rad: JointVector) -> str:
        marker = robot_from_marker(visits.cell, at_rad)
        return explain_hidden_frame(tracker, marker, master.arm.kinematics, at_rad, volume_mm)

    of_master = _turn_frame(
        visits,
        [
            partial(master.joints_at, one.pose, master.home_rad, ONE_SIDE)
            for one in plan_turns(reference, region_mm, marker_mm)
        ],
        explain_hidden,
        master,
        partial(master.settle, arriving=ONE_SIDE, allow_detour=True),
    )
    master.return_home()
    drawn, from_base = visits.drawn_frame, visits.tracker_in_base
    frames_mm = assistant.base.inverse().apply(region_mm)
    home = assistant.flange_pose(assistant.home_rad).rigid.rotation
    facing = (home * drawn.rigid.rotation).as_matrix()[:, 2]
    towards = turn_towards(facing, from_base.translation_mm - frames_mm) * home
    turns = [flange_of(one.pose) for one in plan_turns(towards, frames_mm, drawn.translation_mm)]
    near = working_joints(assistant, turns[:FRAME_LOOKS])
    plan = [partial(assistant.flange_joints, one, near, ONE_SIDE) for one in turns]
    of_assistant = _turn_frame(visits, plan, visits.explain_hidden, assistant, assistant.settle)
    return of_master, of_assistant


def _turn_frame(
    visits: ArmVisits,
    plan: Iterable[Callable[[], JointVector]],
    explain_hidden: Callable[[JointVector], str],
    arm: SupervisedArm,
    settle: Callable[[JointVector], object],
) -> PosePairs:
    flanges: list[Array] = []
    seen: list[Array] = []
    reasons: list[str] = []
    possible = list_possible(plan, reasons, explain_hidden)
    for _ in visits.visit(possible, FRAME_LOOKS, arm, settle, reasons):
        pose = mean_pose(visits.read(FRAMES, arm), arm.frame, FRAMES // 2)
        if pose is None:
            reasons.append(f"{arm.frame} not in view")
            continue
        flanges.append(arm.flange_pose(arm.joints_rad(), ONE_SIDE).as_matrix())
        seen.append(pose.as_matrix())
        doing = f"the {arm.role} turns its frame towards the tracker"
        visits.context.progress(len(seen) / FRAME_LOOKS / 4.0, doing)
        if len(seen) == FRAME_LOOKS:
            break
    if len(seen) < LEAST_FRAME_LOOKS:
        raise POSES_OUT_OF_REACH(
            f"too few poses show the frame {arm.frame}",
            expected=f"{LEAST_FRAME_LOOKS}",
            got=f"{len(seen)}; {', '.join(sorted(set(reasons)))}",
        )
    return PosePairs(np.array(flanges), np.array(seen))
