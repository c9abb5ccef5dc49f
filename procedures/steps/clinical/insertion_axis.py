"""Choice of the axis along which the assistant leads the instrument: its turn about the bore, and its wrist.

The bore leaves the turn free. Chosen is one in reach, in which both arms leave the head in the tracker's view
and all ways are clear; of these the one nearest to the postures in which the bases were measured.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.engine.context import StepContext
from procedures.planning.errors import NotReachable
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.base_postures import face_along, travel_rad, working_joints, wrist_branches
from procedures.steps.clinical.base_to_base import KnownBases
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.room import ExpectedSight, room_watch
from procedures.steps.clinical.surroundings import planning_scene_of
from procedures.steps.clinical.work_progress import DepthStop
from procedures.workcell import Insertion, MountedTool
from procedures.workcell.assistant import Assistant
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, Vector3, joint_vector

ABOVE_GUIDE_MM = 12.0  # of the tip, where it is compared with the axis of the bore
PAST_CONTACT_MM = 0.4  # of the clamp, which slides: more than both arms and their bases are in error
TURN_STEP_RAD = math.radians(15.0)


class Approach(NamedTuple):
    """Axis in the robot frame, the joints at its start, and those on the way there from home, if any."""

    axis: Insertion
    start_rad: JointVector
    via_rad: tuple[JointVector, ...]


class _Candidate(NamedTuple):
    """An axis in the robot frame with its joints, and how well it suits: the smallest first."""

    rank: tuple[bool, bool, int, float]
    axis: Insertion
    start_rad: JointVector
    held_rad: JointVector


def guide_pose(context: StepContext, head_shift_mm: Vector3) -> Transform:
    """Return the guide as the stereo head has seen its mount: the shift belongs to both."""
    workcell = context.workcell
    axis = workcell.place.axis
    pose = workcell.tool_pose(arrived=None if axis is None else axis.arriving)
    return pose.displace(pose.rotation_matrix @ np.asarray(head_shift_mm))


def find_axis(context: StepContext, assistant: Assistant, stop: DepthStop, known: KnownBases) -> Approach:
    """Return how the assistant brings the instrument into the guide. Raises PLAN-007."""
    turns = _list_turns(context, stop, known.head_shift_mm)
    found = _list_reached(assistant, turns, known)
    here_rad, in_sight = assistant.joints_rad(), 0
    in_the_way: list[str] = []
    for one in sorted(found, key=lambda one: one.rank):
        if _hides_head(context, one):
            continue
        in_sight += 1
        surround_at_guide(context, one.held_rad)
        onto = assistant.settle_motion(one.start_rad, one.axis.arriving)
        along = assistant.insert_motion(assistant.axis_in_base(one.axis), one.start_rad)
        blocked = assistant.explain_blocked([along], one.start_rad)
        ways = () if blocked else _list_ways(assistant.home_rad, one.start_rad)
        for via_rad in ways:
            way = [*map(assistant.go_motion, via_rad), onto]
            if not (blocked := assistant.explain_blocked(way, here_rad)):
                return Approach(one.axis, one.start_rad, via_rad)
        in_the_way.append(blocked)
    raise NotReachable(
        f"the assistant cannot bring the instrument into the guide at {context.trajectory}: of "
        f"{2 * len(turns)} turns about its axis and of the wrist {len(found)} are in reach, {in_sight} of "
        f"them leave the head in view of the tracker, and none of those is clear{_count_alike(in_the_way)}",
        action="Place the assistant's cart elsewhere and localize again, or start a run without --dual.",
    )


def surround_at_guide(context: StepContext, near_rad: JointVector) -> None:
    """Surround the assistant with the patient, leaving the corridor of this trajectory open.

    `near_rad` is where it is to be exact: the corridor is as narrow as what an uncalibrated arm errs.
    """
    workcell = context.workcell
    robot_from_ct = context.result_among(RegisteredRobot, lambda made: made[-1] if made else None)
    by = (
        context.result(Correspondence).robot_from_ct if robot_from_ct is None else robot_from_ct.robot_from_ct
    )
    trajectory = context.result(CheckedPlan).trajectory(context.trajectory).trajectory
    guide = workcell.flange_from(MountedTool.GUIDE)
    around = planning_scene_of(context).with_guide(by.transform, guide, trajectory)
    workcell.surround_assistant(around, near_rad)


def _list_turns(context: StepContext, stop: DepthStop, head_shift_mm: Vector3) -> list[Insertion]:
    """List the axes of all turns about the bore."""
    guide, bore = guide_pose(context, head_shift_mm), context.workcell.tools.guide.bore
    top_mm = guide.apply((0.0, 0.0, -bore.reach_mm - bore.length_mm + PAST_CONTACT_MM))
    travel_mm = stop.read_mm + ABOVE_GUIDE_MM + PAST_CONTACT_MM
    axes = []
    for step in range(round(2.0 * math.pi / TURN_STEP_RAD)):
        turn = guide.rigid.rotation * Rotation.from_rotvec([0.0, 0.0, step * TURN_STEP_RAD])
        held = Transform(guide.target, guide.source, RigidTransform.from_components(top_mm, turn))
        axes.append(Insertion(context.trajectory, held, travel_mm))
    return axes


def _list_reached(assistant: Assistant, axes: Sequence[Insertion], known: KnownBases) -> list[_Candidate]:
    """List the axes in reach, with either posture of the wrist.

    First those over which the tracker can compare the frames of both arms, then those near the postures of
    the ball: what the arms err there is part of the bases.
    """
    tracker = assistant.base.inverse() @ known.robot_from_tracker.transform
    frame = known.flange_from_frame.transform
    to_base, onto_flange = assistant.base.inverse(), assistant.flange_from_clamp.inverse()
    inwards = (to_base @ axes[0].held).rotation_matrix[:, 2]
    onwards = face_along(assistant.flange_from_clamp.rotation_matrix[:, 2], inwards)
    flanges = [to_base @ one.held @ onto_flange for one in axes]
    away_rad = [float((onwards.inv() * flange.rigid.rotation).magnitude()) for flange in flanges]
    usual = working_joints(assistant, [flanges[int(np.argmin(away_rad))]])
    found = []
    for near in wrist_branches(assistant):
        for one, away in zip(axes, away_rad, strict=True):
            try:
                at_start = assistant.clamp_joints(one.start, near)
                at_end = assistant.clamp_joints(one.held, at_start)
                signs = tuple(1 if end >= begin else -1 for begin, end in zip(at_start, at_end, strict=True))
                start_rad = assistant.clamp_joints(one.start, near, signs)
            except LimitError:
                continue
            marker = assistant.flange_pose(start_rad) @ frame
            hidden = bool(explain_hidden_frame(tracker, marker, assistant.arm.kinematics, start_rad))
            way_rad = travel_rad(assistant.home_rad, start_rad) + travel_rad(at_start, at_end)
            rank = (hidden, near != usual, round(away / TURN_STEP_RAD), way_rad)
            axis = Insertion(one.trajectory, one.held, one.travel_mm, signs)
            found.append(_Candidate(rank, axis, start_rad, at_end))
    return found


def _list_ways(home_rad: JointVector, start_rad: JointVector) -> tuple[tuple[JointVector, ...], ...]:
    """List ways from home: straight, or drawn back as at home until the base is turned, or the wrist too."""
    _, two, three, four, five, six = home_rad
    first, _, _, *wrist = start_rad
    return (), ((first, two, three, four, five, six),), (joint_vector((first, two, three, *wrist)),)


def _hides_head(context: StepContext, one: _Candidate) -> bool:
    """Return whether both arms, with the assistant on this axis, hide the head from the tracker."""
    workcell = context.workcell
    assert workcell.surroundings is not None
    expected = ExpectedSight(context, room_watch(context), workcell.surroundings)
    here_rad = workcell.joints_rad()
    return any(expected.hidden_at(here_rad, at_rad) for at_rad in (one.start_rad, one.held_rad))


def _count_alike(reasons: Sequence[str]) -> str:
    """List the reasons, the most frequent first, or return ''."""
    counted = [f"{reason} ({count})" for reason, count in Counter(reasons).most_common()]
    return f": {', '.join(counted)}" if counted else ""
