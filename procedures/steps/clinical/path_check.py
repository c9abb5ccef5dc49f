"""Check of all paths before any motion: line of sight, reach, clearance, and one branch of the arm.

A trajectory that cannot be served is put to the operator: nothing is replaced or left out without consent.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field, PlainSerializer, PlainValidator

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import FramedPose, StepResult, Values
from procedures.operator.question import join_answers
from procedures.planning import free_angle
from procedures.planning.guide import place_guides
from procedures.planning.learning_looks import choose_learning_looks, look_sides
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.motions import RESERVE, PreviewedMotion, preview_motions
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.target_error import choose_best_strategies
from procedures.planning.visits import ArmSetting, PathCheck
from procedures.steps.branches import HOLD, LEAVE_OUT, UNREACHABLE, strategy_answer
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.room import ROOM_READS, room_watch
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surroundings import READS, planning_scene_of
from procedures.steps.conditions import needs_guide_unmounted
from procedures.strategies.catalogue import BestOfEach, StrategyByTrajectory
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.strategy import ONE_SIDE, Strategy, arrival_signs, rest_sides
from procedures.strategies.trajectory import Trajectory
from procedures.workcell import MountedTool
from procedures.workcell.motions import AnnouncedMotions
from ronna_hw.arm.clearance.sweep import ClosestPair
from ronna_hw.arm.kinematics import Branch
from ronna_hw.arm.pose import radians6
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.roles import MASTER
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector


def _read_pose(value: object) -> PoseName:
    return value if isinstance(value, PoseName) else PoseName.parse(str(value))


RecordedPose = Annotated[
    PoseName, PlainValidator(_read_pose, json_schema_input_type=str), PlainSerializer(str, str)
]


class ClosestApproach(Values):
    """Closest approach of two bodies."""

    first: str = Field(description="One body.")
    second: str = Field(description="The other.")
    distance_mm: float = Field(description="Between their surfaces.")
    at: float = Field(description="Where on the path, 0 to 1.")

    @classmethod
    def of(cls, closest: ClosestPair) -> ClosestApproach:
        return cls(
            first=closest.first, second=closest.second, distance_mm=closest.distance_mm, at=closest.fraction
        )


class MotionPreview(Values):
    """Preview of a motion from one named pose to another."""

    start: RecordedPose = Field(description="Name of the pose it begins at.")
    end: RecordedPose = Field(description="Name of the pose it ends at.")
    kind: str = Field(
        description="`move` of the joints, straight `line`, `back` on it, or `reserve`: a line along which "
        "the head backs off from a sphere if it must."
    )
    duration_s: float = Field(description="Duration at the intended speed.")
    clear: bool = Field(description="Whether every body keeps enough clearance.")
    closest: ClosestApproach | None = Field(description="The closest pair of bodies.")
    largest_joint_speed_share: float = Field(description="Of the limits of the motion.")
    largest_speed_mm_s: float = Field(description="Largest speed of any moving body.")
    nearest_to_head_mm: float | None = Field(
        description="Smallest distance of any moving body from the head."
    )

    @classmethod
    def of(cls, motion: PreviewedMotion) -> MotionPreview:
        preview = motion.preview
        return cls(
            start=motion.motion.start,
            end=motion.motion.end,
            kind=motion.motion.kind,
            duration_s=preview.duration_s,
            clear=preview.clear,
            closest=None if preview.closest is None else ClosestApproach.of(preview.closest),
            largest_joint_speed_share=preview.largest_joint_speed_share,
            largest_speed_mm_s=preview.largest_speed_mm_s,
            nearest_to_head_mm=preview.nearest_to_head_mm,
        )


def motions_over_spheres(motions: Sequence[MotionPreview], trajectory: str | None) -> list[MotionPreview]:
    """Return the motions of one localization, home moves included, for a trajectory or for the whole case."""
    over = [
        place
        for place, one in enumerate(motions)
        if one.end.kind is PoseKind.FIDUCIAL and trajectory in (None, one.end.trajectory)
    ]
    return list(motions[over[0] : over[-1] + 1]) if over else []


def announce_motions(motions: Sequence[MotionPreview], small: str) -> AnnouncedMotions:
    """Announce motions, at least one, and `small` ones: number, duration, speed and clearance.

    Clearance is also that of the lines in reserve, which a yes covers.
    """
    driven = [one for one in motions if one.kind != RESERVE]
    near = min((one.closest for one in motions if one.closest), key=lambda one: one.distance_mm, default=None)
    return AnnouncedMotions(
        count=len(driven),
        small=small,
        duration_s=sum(one.duration_s for one in driven),
        largest_speed_mm_s=max(one.largest_speed_mm_s for one in motions),
        clearance=f"{near.first} clears {near.second} by {near.distance_mm:.0f} mm"
        if near
        else "nothing near",
    )


class LocalizationPose(Values):
    """Pose for localizing one sphere, or for one look at the skin."""

    fiducial: int = Field(description="Index of the sphere in the CT, or number of the look at the skin.")
    tool_pose: FramedPose = Field(description="Pose robot <- tool with the tool centre on the sphere.")
    approach_rad: JointVector = Field(description="Joints where the approach along its axis begins.")
    joints_rad: JointVector = Field(description="Joints at the sphere.")
    approach_signs: tuple[int, ...] | None = Field(
        default=None,
        description="With strategy `learning`, and at the skin: direction from which each joint arrives, "
        "+1 or -1.",
    )


class TargetPose(Values):
    """Pose for holding the guide at one target, with its approach, by the coarse registration."""

    tool_pose: FramedPose = Field(description="Pose robot <- tool in which the guide is held.")
    approach_rad: JointVector = Field(description="Joints where the approach along the axis begins.")
    joints_rad: JointVector = Field(description="Joints where the guide is held.")
    approach_signs: tuple[int, ...] = Field(description="Direction from which each joint arrives, +1 or -1.")
    rest_sides: tuple[int, ...] | None = Field(
        default=None,
        description="The same where it is sure, 0 where not; none in older records, which took it for sure.",
    )

    @property
    def sides(self) -> tuple[int, ...]:
        """Side of its backlash on which each joint rests, +1 or -1; 0 if not known."""
        return self.approach_signs if self.rest_sides is None else self.rest_sides


class CheckedPaths(StepResult, kind="path_check"):
    """Joints for every localization and target, and every motion between these poses."""

    strategy: str = Field(description="Name of the localization strategy.")
    replaced: dict[str, str] = Field(
        default={}, description="Trajectories for which the operator agreed to another strategy, and which."
    )
    chosen: dict[str, str] = Field(
        default={}, description="With strategy `best`: the one chosen, by trajectory."
    )
    free_angle_turns_rad: dict[str, float] = Field(
        description="Rotation of each trajectory about its axis, and of the neutral "
        "orientation if there is one."
    )
    branch: Branch | None = Field(description="Branch of the arm's inverse kinematics.")
    joint_ranges_rad: tuple[tuple[float, float], ...] = Field(description="Least and largest, per joint.")
    largest_move_rad: float = Field(description="Largest rotation of a joint in one move.")
    motions: tuple[MotionPreview, ...] = Field(description="Every motion of the case.")
    localizations: dict[str, tuple[LocalizationPose, ...]] = Field(description="By trajectory.")
    targets: dict[str, TargetPose] = Field(description="By trajectory.")
    left_out: dict[str, str] = Field(
        default={}, description="Trajectories that cannot be reached, and why; they are not targeted."
    )

    def leaves_out(self) -> Mapping[str, str]:
        return self.left_out

    def strategy_of(self, trajectory: str) -> str:
        return self.replaced.get(trajectory, self.chosen.get(trajectory, self.strategy))

    @property
    def skin_looks(self) -> tuple[LocalizationPose, ...]:
        """Looks at the skin, for all trajectories, in the order in which they are taken."""
        return self.localizations.get(SKIN, ())

    def looks_for(self, trajectory: str | None) -> tuple[tuple[str, LocalizationPose], ...]:
        """Return the looks of `localizations_for`, each with its axis."""
        over_spheres = [axis for axis in self.localizations if axis != SKIN]
        axes = over_spheres if trajectory is None else (trajectory,)
        return tuple((axis, one) for axis in axes for one in self.localizations[axis])

    def localizations_for(self, trajectory: str | None) -> tuple[LocalizationPose, ...]:
        """Return those of spheres for a trajectory, or for None all of a strategy that registers once.

        In the order in which they are taken. Raises KeyError if there are none for this trajectory.
        """
        return tuple(one for _, one in self.looks_for(trajectory))


def run(context: StepContext) -> Outcome[CheckedPaths]:
    """Choose joints for every remaining localization and target. Raises PLAN-007 naming all failing poses."""
    for before in (Correspondence, LocalizedFiducials):
        context.result(before)
    context.progress(0.0, "checking every path")
    return check_all_paths(context, arm_setting_of(context))


def arm_setting_of(context: StepContext) -> ArmSetting:
    """Return arm, tools, start and surroundings of the case, with the head by the coarse registration."""
    workcell, settings = context.workcell, context.setting.settings
    # The servo brings the head onto a sphere, so the arm deviates from its path by the error of the mount.
    sizes = ErrorSizes.stated(settings, workcell.calibrations.arm)
    return ArmSetting(
        kinematics=workcell.master.arm.kinematics,
        robot_from_ct=context.result(Correspondence).robot_from_ct.transform,
        flange_from_tool=workcell.master.flange_from(MountedTool.GUIDE),
        strategy=context.clinical.strategy,
        flange_from_stereo=workcell.master.flange_from(MountedTool.STEREO_HEAD),
        start_rad=context.result(CheckedSetUp).homes_rad[MASTER],
        limits=workcell.master.arm.limits(),
        approach_mm=settings.approach_mm,
        scene=planning_scene_of(context).with_reserve(sizes.tool_mm),
        sizes=sizes,
        gauge_rad=radians6(*workcell.tools.guide.gauge.joints_deg),
        sights=room_watch(context).sights if len(workcell.arms) > 1 else (),  # to watch an insertion
    )


def check_all_paths(context: StepContext, setting: ArmSetting) -> Outcome[CheckedPaths]:
    """Search paths over the matched spheres, over the skin, and to the targets. Raises PLAN-007.

    Unreachable trajectories are put to the operator.
    """
    matched = [pair[0] for pair in context.result(Correspondence).pairs]
    centres_mm = context.result(LocalizedFiducials).centres_mm[matched]
    sight = StereoSight.of(context.workcell.calibrations.stereo_head)
    plan, scene = context.result(CheckedPlan), setting.scene
    assert scene is not None  # a case always checks clearance
    search = PathSearch(context, setting, centres_mm, sight)
    held = place_guides(plan.plan, context.workcell.tools.guide.bore)
    turned = search.find_paths([one for one in held if one.identifier in context.remaining])
    check = turned.check
    if turned.remark:
        context.find(turned.remark)
    motions = preview_motions(setting, scene, check, turned.axes.targeted)
    replaced = {name: one.name for name, one in search.replaced.items()}
    best = search.setting.strategy
    chosen = {name: one.name for name, one in best.others.items()} if isinstance(best, BestOfEach) else {}
    return Outcome(
        CheckedPaths(
            strategy=context.clinical.strategy.name,
            replaced=replaced,
            chosen=chosen,
            free_angle_turns_rad=dict(turned.turns_rad),
            branch=check.branch,
            joint_ranges_rad=check.joint_ranges_rad,
            largest_move_rad=check.largest_turn_rad,
            motions=tuple(MotionPreview.of(motion) for motion in motions),
            localizations=_build_localizations(check, matched, setting),
            targets=_build_targets(check, setting),
            left_out=search.left_out,
        ),
        summary=f"{format_count(len(check.reached), 'pose')} in one branch"
        + _describe_closest(motions)
        + _describe_turns(turned)
        + "".join(f"; {name} by {strategy}" for name, strategy in (chosen | replaced).items())
        + "".join(f"; without {name}" for name in search.left_out),
    )


def _describe_closest(motions: Sequence[PreviewedMotion]) -> str:
    closest = [motion.preview.closest for motion in motions]
    distances = [one.distance_mm for one in closest if one is not None]
    return f", smallest clearance {min(distances):.0f} mm" if distances else ""


def _describe_turns(turned: free_angle.TurnedPaths) -> str:
    turns = [
        f"{name} turned by {math.degrees(turn):+.0f} deg" for name, turn in turned.turns_rad.items() if turn
    ]
    return f"; {', '.join(turns)}" if turns else ""


def _build_localizations(
    check: PathCheck, numbers: Sequence[int], setting: ArmSetting
) -> dict[str, tuple[LocalizationPose, ...]]:
    poses: dict[str, tuple[LocalizationPose, ...]] = {}
    for reached in check.reached:
        visit = reached.visit
        if visit.name.kind is PoseKind.FIDUCIAL and visit.name.fiducial is not None:
            sides: tuple[int, ...] | None = None
            at_skin = visit.name.trajectory == SKIN
            if at_skin:
                sides = ONE_SIDE  # its known backlash helps only if the side is known
            elif setting.strategy.learns_arm:
                sides = look_sides(setting, check.targets, [visit.name.trajectory])[0]
            pose = LocalizationPose(
                fiducial=visit.name.fiducial if at_skin else numbers[visit.name.fiducial],
                tool_pose=FramedPose.of(visit.pose),
                approach_rad=reached.approach_rad,
                joints_rad=reached.at_rad,
                approach_signs=sides,
            )
            poses[visit.name.trajectory] = (*poses.get(visit.name.trajectory, ()), pose)
    return poses


def _build_targets(check: PathCheck, setting: ArmSetting) -> dict[str, TargetPose]:
    return {
        reached.visit.name.trajectory: TargetPose(
            tool_pose=FramedPose.of(reached.visit.pose),
            approach_rad=reached.approach_rad,
            joints_rad=reached.at_rad,
            approach_signs=arrival_signs(
                setting.kinematics, reached.visit.pose, reached.at_rad, setting.flange_from_tool
            ),
            rest_sides=rest_sides(
                setting.kinematics,
                reached.visit.pose,
                reached.at_rad,
                setting.flange_from_tool,
                reached.visit.approach_mm,
            ),
        )
        for reached in check.reached
        if reached.visit.name.kind is PoseKind.TARGET
    }


@dataclass
class PathSearch:
    """Path search that consults the operator about unreachable trajectories.

    `centres_mm` (n, 3) are the fiducials in the CT. By trajectory, `left_out` has the reason and `replaced`
    the strategy that serves it instead.
    """

    context: StepContext
    setting: ArmSetting
    centres_mm: Array
    sight: StereoSight
    left_out: dict[str, str] = field(default_factory=dict)
    replaced: dict[str, Strategy] = field(default_factory=dict)
    _tried: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    def find_paths(self, trajectories: Sequence[Trajectory]) -> free_angle.TurnedPaths:
        """Find paths of all trajectories not left out. Raises PLAN-007 for one that stays out of reach."""
        self.setting = choose_best_strategies(self.setting, trajectories, self.centres_mm, self.sight)
        while True:
            remain = [one for one in trajectories if one.identifier not in self.left_out]
            setting = self.setting
            if self.replaced:
                setting = replace(setting, strategy=StrategyByTrajectory(setting.strategy, self.replaced))
            turned = free_angle.choose_free_angles(setting, remain, self.centres_mm, self.sight)
            if turned.check.passed:
                return choose_learning_looks(setting, turned, self.centres_mm, self.sight)
            self._decide(turned.check, remain)

    def _decide(self, check: PathCheck, trajectories: Sequence[Trajectory]) -> None:
        reasons = free_angle.find_unreached(check, trajectories)
        reaching_strategies = {
            name: free_angle.find_alternatives(
                self.setting, one, self.centres_mm, self.sight, self._tried[name]
            )
            for one in trajectories
            if (name := one.identifier) in reasons
        }
        others = [one.identifier for one in trajectories if one.identifier not in reasons]
        for name, reason in reasons.items():
            self._ask(check, name, reason, reaching_strategies, others)

    def _ask(
        self,
        check: PathCheck,
        name: str,
        reason: str,
        reaching_strategies: dict[str, tuple[Strategy, ...]],
        others: Sequence[str],
    ) -> None:
        """Offer to change a trajectory's strategy or leave it out. Raises PLAN-007 if neither is accepted."""
        # One registration for all cannot be made by two strategies.
        offered = reaching_strategies[name] if self.setting.strategy.localizes_per_trajectory else ()
        answers = (*(strategy_answer(one.name) for one in offered), *((LEAVE_OUT,) if others else ()), HOLD)
        if answers == (HOLD,):
            check.require(free_angle.advice(reaching_strategies))
        current = self.replaced.get(name, self.setting.strategy)
        reach_text = (
            f"; {join_answers([one.name for one in reaching_strategies[name]])} would reach it"
            if reaching_strategies[name]
            else ""
        )
        remain = f"; {', '.join(others)} would remain without it" if others else ""
        question = UNREACHABLE.question(
            f"{name} cannot be reached with {current.name} at any angle about its axis",
            f"{reason}{reach_text}{remain}",
            name,
            answers,
        )
        answer = self.context.choose(question)
        agreed = [one for one in offered if answer == strategy_answer(one.name)]
        if agreed:
            self._tried[name].add(agreed[0].name)
            self.replaced[name] = agreed[0]
        elif answer == LEAVE_OUT:
            self.left_out[name] = reason
            self.replaced.pop(name, None)
        else:
            check.require(free_angle.advice(reaching_strategies))


STEP = StepSpec(
    CheckedPaths,
    "Check every path",
    Phase.PREPARATION,
    run,
    reads=(*ROOM_READS, CheckedSetUp, *READS),
    preconditions=needs_guide_unmounted,
)
