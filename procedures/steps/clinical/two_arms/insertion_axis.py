"""Choice of the axis along which the assistant leads the instrument: its turn about the bore, and its wrist.

The bore leaves the turn free. Chosen is one in reach, in which both arms leave the head in the tracker's view
and all ways are clear; of these the one nearest to the postures in which the bases were measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from scipy.spatial.transform import RigidTransform

from procedures.calibration.arm_errors import FoundArm
from procedures.engine.context import StepContext
from procedures.planning.errors import NotReachable
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import KnownBases, RegisteredRobot
from procedures.steps.clinical.room import ExpectedSight, room_watch
from procedures.steps.clinical.surroundings import planning_scene_of
from procedures.steps.clinical.two_arms import base_postures
from procedures.steps.clinical.two_arms.base_visits import stated_arms
from procedures.steps.clinical.work_progress import DepthStop
from procedures.strategies.strategy import LAST_STRETCH_MM, Sides
from procedures.workcell import InsertionAxis, MountedTool, Workcell
from procedures.workcell.assistant import Assistant
from ronna_hw.devices.sensors import VolumeSections, measuring_volume_mm
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from ronna_hw.roles import ASSISTANT
from ronna_hw.tool_record import GuideBore
from ronna_hw.vectors import JointVector

ABOVE_GUIDE_MM = 12.0  # of the tip, where it is compared with the axis of the bore
WRIST_JOINTS = 3  # the last ones, which turn the instrument where it is
# Safety against a clamp that pushes the guide (U).
PAST_CONTACT_MM = 0.4  # of the clamp, which slides: more than both arms and their bases are in error


class AxisApproach(NamedTuple):
    """Axis in the robot frame, the joints at its start, and those on the way there from home, if any."""

    axis: InsertionAxis
    start_rad: JointVector
    via_rad: tuple[JointVector, ...]


class _Candidate(NamedTuple):
    """An axis in the robot frame with its joints by the record, and how well it suits: the smallest first."""

    rank: tuple[bool, bool, int, float]
    axis: InsertionAxis
    start_rad: JointVector
    held_rad: JointVector


class Meeting(NamedTuple):
    """Both arms at a guide, with their errors as found, and the length of its bore."""

    master: FoundArm
    assistant: FoundArm
    bore: GuideBore

    @classmethod
    def of(cls, context: StepContext, known: KnownBases) -> Meeting:
        """Return the arms of a case."""
        master, assistant = stated_arms(context)
        return cls(
            FoundArm(master, known.master_errors),
            FoundArm(assistant, known.assistant_errors),
            context.workcell.tools.guide.bore,
        )

    def guide(self, workcell: Workcell) -> Transform:
        """Return the pose of the guide, robot frame, corrected for its arm's identified errors."""
        axis, reach_mm = workcell.master.place.axis, self.bore.reach_mm
        arrived, joints_rad = None if axis is None else axis.arriving, workcell.master.joints_rad()
        by_record = workcell.master.tool_pose(joints_rad, arrived)
        return self.master.displace(
            by_record, joints_rad, arrived, (-reach_mm - self.bore.length_mm, -reach_mm)
        )

    def clamp(self, assistant: Assistant, arrived: Sides) -> Transform:
        """Return the pose of the assistant's clamp, robot frame, corrected for its identified errors."""
        joints_rad, length_mm = assistant.joints_rad(), self.bore.length_mm
        by_record = assistant.base.inverse() @ assistant.clamp_pose(joints_rad, arrived)
        return assistant.base @ self.assistant.displace(by_record, joints_rad, arrived, (0.0, length_mm))

    def command(self, assistant: Assistant, axis: InsertionAxis, held_rad: JointVector) -> InsertionAxis:
        """Return the axis along which the assistant, by its record, leads the instrument along `axis`."""
        held = assistant.base.inverse() @ axis.held
        really = self.assistant.displace(held, held_rad, axis.arriving, (0.0, self.bore.length_mm))
        return replace(axis, held=assistant.base @ held @ really.inverse() @ held)


def find_axis(context: StepContext, assistant: Assistant, stop: DepthStop, known: KnownBases) -> AxisApproach:
    """Return how the assistant brings the instrument into the guide. Raises PLAN-007."""
    meeting, robot_from_ct = Meeting.of(context, known), registered_here(context)
    turns = _list_turns(context, stop, meeting)
    found = _list_reached(assistant, turns, known, measuring_volume_mm(context.workcell.tracker))
    here_rad, in_sight = assistant.joints_rad(), 0
    in_the_way: list[str] = []
    for one in sorted(found, key=lambda one: one.rank):
        if _hides_head(context, one):
            continue
        in_sight += 1
        surround_at_guide(context, one.held_rad, robot_from_ct)
        axis = meeting.command(assistant, one.axis, one.held_rad)
        try:
            start_rad = assistant.clamp_joints(axis.start, one.start_rad, axis.arriving)
        except LimitError as beyond:
            in_the_way.append(f"{beyond.code} ({beyond.meaning})")
            continue
        onto = assistant.settle_motion(start_rad, axis.arriving)
        along = assistant.insert_motion(assistant.axis_in_base(axis), start_rad)
        blocked = assistant.explain_blocked([along], start_rad)
        ways = () if blocked else _list_ways(assistant.home_rad, start_rad)
        for via_rad in ways:
            way = [*map(assistant.go_motion, via_rad), onto]
            if not (blocked := assistant.explain_blocked(way, here_rad)):
                return AxisApproach(axis, start_rad, via_rad)
        in_the_way.append(blocked)
    raise NotReachable(
        f"the assistant cannot bring the instrument into the guide at {context.trajectory}: of "
        f"{2 * len(turns)} turns about its axis and of the wrist {len(found)} are in reach, {in_sight} of "
        f"them leave the head in view of the tracker, and none of those is clear{_count_alike(in_the_way)}",
        action="Place the assistant's cart elsewhere and localize again, or start a run without --dual.",
    )


def registered_here(context: StepContext) -> Transform:
    """Return the pose ROBOT <- CT for this trajectory: by its own registration, or by the first match."""

    def own(made: Sequence[RegisteredRobot]) -> RegisteredRobot | None:
        here = [one for one in made if context.trajectory in one.trajectories] or list(made)
        return here[-1] if here else None

    registered = context.result_among(RegisteredRobot, own)
    if registered is None:
        return context.result(Correspondence).robot_from_ct.transform
    return registered.robot_from_ct_at(context.trajectory)


def surround_at_guide(context: StepContext, near_rad: JointVector, robot_from_ct: Transform) -> None:
    """Surround the assistant with the patient, leaving the corridor of this trajectory open.

    `near_rad` is where it is to be exact: the corridor is as narrow as what an uncalibrated arm errs.
    """
    workcell = context.workcell
    trajectory = context.result(CheckedPlan).trajectory(context.trajectory).trajectory
    guide = workcell.master.flange_from(MountedTool.GUIDE)
    around = planning_scene_of(context).with_guide(robot_from_ct, guide, trajectory)
    workcell.assistant.surround(around, near_rad)


def _list_turns(context: StepContext, stop: DepthStop, meeting: Meeting) -> list[InsertionAxis]:
    """List the axes of all turns about the bore."""
    guide, bore = meeting.guide(context.workcell), meeting.bore
    top_mm = guide.apply((0.0, 0.0, -bore.reach_mm - bore.length_mm + PAST_CONTACT_MM))
    travel_mm = stop.read_mm + ABOVE_GUIDE_MM + PAST_CONTACT_MM
    axes = []
    for turn in base_postures.turns_about_axis(guide.rigid.rotation):
        held = Transform(guide.target, guide.source, RigidTransform.from_components(top_mm, turn))
        axes.append(InsertionAxis(context.trajectory, held, travel_mm))
    return axes


def _list_reached(
    assistant: Assistant, axes: Sequence[InsertionAxis], known: KnownBases, volume_mm: VolumeSections
) -> list[_Candidate]:
    """List the axes in reach, with either posture of the wrist.

    First those in the wrist's posture at the looks, for which it is known what the arm errs; of these, those
    over which the tracker can compare the frames of both arms.
    """
    tracker = assistant.base.inverse() @ known.robot_from_tracker.transform
    frame = known.flange_from_frame.transform
    to_base, onto_flange = assistant.base.inverse(), assistant.flange_from_clamp.inverse()
    inwards = (to_base @ axes[0].held).rotation_matrix[:, 2]
    onwards = base_postures.face_along(assistant.flange_from_clamp.rotation_matrix[:, 2], inwards)
    flanges = [to_base @ one.held @ onto_flange for one in axes]
    away_rad = [float((onwards.inv() * flange.rigid.rotation).magnitude()) for flange in flanges]
    kinematics = assistant.arm.kinematics
    found = []
    for near in base_postures.wrist_branches(assistant):
        other_wrist = kinematics.branch_of(near) != kinematics.branch_of(known.assistant_rad)
        for one, away in zip(axes, away_rad, strict=True):
            try:
                at_start = assistant.clamp_joints(one.start, near)
                at_end = assistant.clamp_joints(one.held, at_start)
                # Not those of the whole way: some joints turn back on it, and would rest on their other side.
                before = assistant.clamp_joints(one.pose_at(one.travel_mm - LAST_STRETCH_MM), at_end)
                signs = tuple(
                    1 if after >= earlier else -1 for earlier, after in zip(before, at_end, strict=True)
                )
            except LimitError:
                continue
            marker = assistant.flange_pose(at_start) @ frame
            hidden = bool(explain_hidden_frame(tracker, marker, kinematics, at_start, volume_mm))
            way_rad = base_postures.travel_rad(assistant.home_rad, at_start) + base_postures.travel_rad(
                at_start, at_end
            )
            rank = (other_wrist, hidden, round(away / base_postures.TURN_STEP_RAD), way_rad)
            found.append(_Candidate(rank, replace(one, arriving=signs), at_start, at_end))
    return found


def _list_ways(home_rad: JointVector, start_rad: JointVector) -> tuple[tuple[JointVector, ...], ...]:
    """List ways from home: straight, or drawn back as at home until the base is turned, or the wrist too."""
    base = start_rad[:1]
    drawn_back, wrist = home_rad[1:-WRIST_JOINTS], start_rad[-WRIST_JOINTS:]
    return (), ((*base, *home_rad[1:]),), ((*base, *drawn_back, *wrist),)


def _hides_head(context: StepContext, one: _Candidate) -> bool:
    """Return whether both arms, with the assistant on this axis, hide the head from the tracker."""
    workcell = context.workcell
    assert workcell.master.surroundings is not None
    expected = ExpectedSight(context, room_watch(context), workcell.master.surroundings)
    here_rad = workcell.master.joints_rad()
    others = ({ASSISTANT: at_rad} for at_rad in (one.start_rad, one.held_rad))
    return any(expected.hidden_at(here_rad, others_rad) for others_rad in others)


def _count_alike(reasons: Sequence[str]) -> str:
    """List the reasons, the most frequent first, or return ''."""
    counted = [f"{reason} ({count})" for reason, count in Counter(reasons).most_common()]
    return f": {', '.join(counted)}" if counted else ""
