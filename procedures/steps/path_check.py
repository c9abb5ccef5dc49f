"""Check every pose and motion of the whole procedure before it moves: sight, reach, clearance, one branch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.planning.free_angle import TurnedPaths, choose_free_angles
from procedures.planning.motions import PreviewedMotion, previews_of
from procedures.planning.sight import StereoSight
from procedures.planning.visits import ArmSetting, PathCheck, Reached, VisitKind
from procedures.steps.arm_frames import guide_in_flange, stereo_tool_in_flange
from procedures.steps.payloads import points_from, pose_from, pose_payload
from procedures.steps.plan_check import planned
from procedures.steps.surroundings import planning_scene_of
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.orientation import back_along_axis
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector

STRATEGY = "ocs"
LAST_STRETCH_MM = 5.0  # of the line to a target: how each joint turns there decides its backlash


def run(context: StepContext) -> Outcome:
    """Choose joints for every localization and target; raises PLAN-007 with every pose that fails."""
    correspondence = context.case.get("correspondence")
    localization = context.case.get("fiducial_localization")
    plan = context.case.get("plan_check")
    markers = localization.payload["markers"]
    matched = [int(pair[0]) for pair in correspondence.payload["pairs"]]
    home: JointVector = tuple(context.case.get("set_up").payload["home_rad"])
    scene = planning_scene_of(context)
    setting = ArmSetting(
        kinematics=context.devices.arm.kinematics,
        robot_from_ct=pose_from(correspondence.payload["robot_from_ct"]),
        flange_from_tool=guide_in_flange(context),
        strategy=strategy_named(STRATEGY),
        flange_from_stereo=stereo_tool_in_flange(context),
        start_rad=home,
        approach_mm=context.theatre.procedure.standoff_mm,
        scene=scene,
    )
    trajectories = [one.trajectory for one in planned(context).trajectories]
    centres = points_from([markers[index]["centre_mm"] for index in matched])
    context.progress(0.0, "checking every path")
    turned = choose_free_angles(
        setting, trajectories, centres, StereoSight.of(context.calibrations.stereo_head)
    )
    check = turned.check
    check.require()
    motions = previews_of(setting, scene, check, turned.trajectories)
    return Outcome(
        payload={
            "strategy": STRATEGY,
            "free_angle_turns_rad": {
                one.identifier: turn for one, turn in zip(turned.trajectories, turned.turns_rad, strict=True)
            },
            "branch_status": check.branch,
            "joint_ranges_rad": [list(limits) for limits in check.joint_ranges_rad],
            "largest_move_rad": max(move.largest_rad for move in check.moves),
            "motions": [motion.as_payload() for motion in motions],
            "localizations": _localizations(check, matched),
            "targets": _targets(check, setting),
        },
        parents=(correspondence, plan, context.case.get("set_up")),
        summary=f"{len(check.reached)} poses in one branch" + _closest_told(motions) + _turns_told(turned),
    )


def _closest_told(motions: Sequence[PreviewedMotion]) -> str:
    closest = [motion.preview.closest for motion in motions]
    distances = [one.distance_mm for one in closest if one is not None]
    return f", clear by {min(distances):.0f} mm" if distances else ""


def _turns_told(turned: TurnedPaths) -> str:
    told = [
        f"{one.identifier} turned by {math.degrees(turn):+.0f} deg"
        for one, turn in zip(turned.trajectories, turned.turns_rad, strict=True)
        if turn
    ]
    return f"; {', '.join(told)}" if told else ""


def _localizations(check: PathCheck, matched: list[int]) -> dict[str, list[dict[str, Any]]]:
    rows: dict[str, list[dict[str, Any]]] = {}
    for reached in check.reached:
        visit = reached.visit
        if visit.kind is VisitKind.LOCALIZATION and visit.fiducial is not None:
            rows.setdefault(visit.trajectory, []).append(
                {
                    "fiducial": matched[visit.fiducial],  # index in the list of the CT
                    "tool_pose": pose_payload(visit.pose),
                    "approach_rad": list(reached.approach_rad),
                    "joints_rad": list(reached.at_rad),
                }
            )
    return rows


def _targets(check: PathCheck, setting: ArmSetting) -> dict[str, dict[str, Any]]:
    return {
        reached.visit.trajectory: {
            "tool_pose": pose_payload(reached.visit.pose),
            "standoff_rad": list(reached.approach_rad),
            "joints_rad": list(reached.at_rad),
            "approach_signs": _approach_signs(reached, setting),
        }
        for reached in check.reached
        if reached.visit.kind is VisitKind.TARGET
    }


def _approach_signs(reached: Reached, setting: ArmSetting) -> list[int]:
    """Direction (+1 or -1) in which each joint arrives at the target."""
    before = back_along_axis(reached.visit.pose, LAST_STRETCH_MM) @ setting.flange_from_tool.inverse()
    kinematics, at_rad = setting.kinematics, reached.at_rad
    joints = kinematics.solve_branch(Pose.from_transform(before), kinematics.branch_of(at_rad), at_rad)
    return [1 if after >= earlier else -1 for earlier, after in zip(joints, reached.at_rad, strict=True)]


STEP = StepSpec(
    "path_check",
    "Check every path",
    needs=("correspondence", "plan_check", "set_up"),
    run=run,
)
