"""Positioning of the guide at an entry: a joint move to the axis, then a linear move along it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.guide_displacement import measure_guide_at_rest
from procedures.guards.room_watch import RoomLook
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.question import YES, Topic
from procedures.planning.errors import NotReachable
from procedures.planning.guide import place_guide
from procedures.steps.branches import KEPT_REGISTRATION
from procedures.steps.clinical import room
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.surroundings import READS, surround_guide
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool
from procedures.steps.clinical.tool_mounting import require_seen_in_place
from procedures.steps.clinical.unnoticed import look_at_target
from procedures.steps.conditions import needs_tool
from procedures.strategies.trajectory import refine_target_pose
from procedures.workcell import InsertionAxis, MountedTool, Workcell
from procedures.workcell.arm_history import stands_at
from ronna_hw.arm.errors import NotClear, OutOfJointRange, Singular, Unreachable
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

VIA_HOME = "home, where the tracker sees head and arm, then "
UNWATCHED = " The arm is expected to hide the head from the tracker there."
REFUSALS = (Unreachable, Singular, OutOfJointRange, NotClear)


class PositionedGuide(StepResult, kind="positioning"):
    """Commanded pose of the guide, and the joints on arrival."""

    tool_pose: FramedPose = Field(description="Pose robot <- tool in which the guide is held, as commanded.")
    joints_rad: JointVector = Field(description="Measured joints on arrival.")


def run(context: StepContext) -> Outcome[PositionedGuide]:
    """Bring the guide to its held pose before the entry, after rereading which tool is mounted."""
    workcell, trajectory = context.workcell, context.trajectory
    context.result(MountedGuide)
    context.result(CheckedTool)
    mounted = workcell.master.mount.check(MountedTool.GUIDE)
    robot_from_ct = _require_registration(context).robot_from_ct_at(trajectory)
    paths = context.result(CheckedPaths)
    insertion = insertion_for(context, robot_from_ct)
    standoff_mm = context.result(CheckedPlan).plan.standoff_mm
    planned = paths.targets[trajectory]
    expected = room.build_expected_sight(context, surround_guide(context, robot_from_ct, planned.joints_rad))
    with name_refusals(trajectory):
        approach_rad = workcell.master.joints_at(insertion.start, planned.approach_rad, insertion.arriving)
    is_hidden = expected.hidden_at(approach_rad) or expected.hidden_at(planned.joints_rad)
    via_home = not workcell.master.settled_home
    with name_refusals(trajectory):
        workcell.master.supervised.confirm(
            Topic.APPROACH,
            f"Move {VIA_HOME if via_home else ''}over {trajectory} with tool {mounted}, then "
            f"{insertion.travel_mm:.0f} mm along the axis to {standoff_mm:.0f} mm above the entry?"
            f"{UNWATCHED if is_hidden else ''}",
            [
                *([workcell.master.return_motion()] if via_home else []),
                workcell.master.go_motion(approach_rad),
                workcell.master.insert_motion(insertion, approach_rad),
            ],
            trajectory,
        )
    workcell.master.mount.check(MountedTool.GUIDE)  # a question may stand for minutes
    if via_home:
        _require_guide_in_seat(context, room.check_room(context, f"before {trajectory}"))
        workcell.start()
        workcell.master.return_home()
    _require_guide_in_seat(context, room.require_unmoved(context, f"before {trajectory}"))
    workcell.start()
    with room.require_head_in_view(context):
        context.progress(0.0, f"moving over {trajectory}")
        with name_refusals(trajectory, workcell):
            workcell.master.go(approach_rad)
            room.check_room(context, f"over {trajectory}")
            context.progress(0.5, f"moving along {trajectory}")
            reached = workcell.master.insert(insertion)
        look = look_at_target(context)
    rest = measure_guide_at_rest(workcell, trajectory, look.reading.tracker_frames, context.find)
    context.setting.memory.keep(rest)
    return Outcome(
        PositionedGuide(tool_pose=FramedPose.of(insertion.held), joints_rad=reached.joints_rad),
        summary=f"the guide is held {standoff_mm:.0f} mm in front of the entry",
    )


def _require_guide_in_seat(context: StepContext, look: RoomLook) -> None:
    """Raise TOOL-006 if a look shows that the guide has moved on its mount since it was checked."""
    if (frame := context.workcell.tools.guide.record.frame) is not None:
        require_seen_in_place(context, frame, look, must_see=False)


def insertion_for(context: StepContext, robot_from_ct: Transform) -> InsertionAxis:
    """Return the guide's insertion for this step's trajectory, by its registration."""
    trajectory = context.trajectory
    paths = context.result(CheckedPaths)
    checked = context.result(CheckedPlan)
    along = place_guide(checked.plan, checked.trajectory(trajectory), context.workcell.tools.guide.bore)
    held = refine_target_pose(paths.targets[trajectory].tool_pose.transform, along, robot_from_ct)
    arriving = paths.targets[trajectory].sides
    return InsertionAxis(trajectory, held, context.setting.settings.approach_mm, arriving)


@contextmanager
def name_refusals(trajectory: str, moving: Workcell | None = None) -> Iterator[None]:
    """Convert refusals to PLAN-007 with the trajectory's name, stating whether the arm has moved."""
    start_rad = None if moving is None else moving.master.joints_rad()
    try:
        yield
    except REFUSALS as problem:
        what = f"{trajectory} cannot be reached: {problem.summary}"
        if moving is None or start_rad is None or _stands_still(moving, start_rad):
            raise NotReachable(what) from problem
        action = f"The arm is on its way: send it home. {NotReachable.action}"
        raise NotReachable(f"{what}; the arm has moved", action=action) from problem


def _stands_still(workcell: Workcell, at_rad: JointVector) -> bool:
    with suppress(RonnaError):  # an arm in fault reports no joints
        return stands_at(workcell.master.joints_rad(), at_rad)
    return False


def _require_registration(context: StepContext) -> RegisteredRobot:
    """Return the registration. Raises PRO-007 if it predates an arm fault and the operator rejects it."""
    registered = context.result(RegisteredRobot)
    fault = context.doubt(RegisteredRobot)
    if fault is not None:
        question = KEPT_REGISTRATION.question(
            f"Keep the registration for {context.trajectory}? Neither the head, the cart nor the "
            "tracker may have moved.",
            f"it is older than a fault of the arm: {fault}",
            context.trajectory,
        )
        if context.choose(question) != YES:
            raise GateFailed(
                f"the registration for {context.trajectory} is older than a fault of the arm",
                got=fault,
                action="Localize again, starting with the tracker.",
            )
        context.keep(RegisteredRobot)
    return registered


STEP = StepSpec(
    PositionedGuide,
    "Position the guide in front of the entry",
    Phase.OPERATION,
    run,
    asks=(Topic.APPROACH,),
    scope=Scope.TRAJECTORY,
    reads=(RegisteredRobot, MountedGuide, CheckedTool, CheckedPaths, *room.ROOM_READS, *READS),
    moves=True,
    preconditions=needs_tool(MountedTool.GUIDE),
)
