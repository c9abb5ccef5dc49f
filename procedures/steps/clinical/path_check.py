"""Check every pose and motion of the whole procedure before it moves: sight, reach, clearance, one branch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pydantic import Field

from procedures.calibration.arm_sources import ErrorSizes
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import FramedPose, Numbers6, StepResult, Values
from procedures.planning.path_check.free_angle import TurnedPaths
from procedures.planning.path_check.motions import PreviewedMotion, previews_of
from procedures.planning.path_check.visits import ArmSetting, PathCheck, VisitKind
from procedures.planning.plan.guide_hold import held_trajectories
from procedures.planning.sight.stereo_head import StereoSight
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.paths.previews import MotionPreview
from procedures.steps.clinical.paths.search import PathSearch
from procedures.steps.clinical.paths.surroundings import READS, planning_scene_of
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import localizable
from procedures.strategies.approach import arrival_signs
from procedures.strategies.best import BestOfEach
from procedures.workcell import MountedTool
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.kinematics import Branch


class LocalizationPose(Values):
    """How one sphere will be localized."""

    fiducial: int = Field(description="Index of the sphere in the CT.")
    tool_pose: FramedPose = Field(description="Pose robot <- tool with the tool centre on the sphere.")
    approach_rad: Numbers6 = Field(description="Joints where the approach along its axis begins.")
    joints_rad: Numbers6 = Field(description="Joints at the sphere.")


class TargetPose(Values):
    """How the guide comes to where it is held for one target, by the coarse registration."""

    tool_pose: FramedPose = Field(description="Pose robot <- tool in which the guide is held.")
    approach_rad: Numbers6 = Field(description="Joints where the approach along the axis begins.")
    joints_rad: Numbers6 = Field(description="Joints where the guide is held.")
    approach_signs: tuple[int, ...] = Field(description="Direction from which each joint arrives, +1 or -1.")


class CheckedPaths(StepResult, kind="path_check"):
    """Joints for every localization and target, and every motion between them."""

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
        """Name of the strategy of one trajectory."""
        return self.replaced.get(trajectory, self.chosen.get(trajectory, self.strategy))

    def localizations_for(self, trajectory: str | None) -> tuple[LocalizationPose, ...]:
        """The localizations that serve a trajectory; for None the one set of a strategy that localizes once.

        Raises KeyError when there are none for this trajectory, or more than one set.
        """
        if trajectory is not None:
            return self.localizations[trajectory]
        if len(self.localizations) != 1:
            raise KeyError(f"{len(self.localizations)} sets of localizations, one for each trajectory")
        return next(iter(self.localizations.values()))


def run(context: StepContext) -> Outcome[CheckedPaths]:
    """Choose joints for every localization and target that remain; PLAN-007 with every pose that fails."""
    correspondence = context.result(Correspondence)
    localization = context.result(LocalizedFiducials)
    plan = context.result(CheckedPlan)
    matched = [pair[0] for pair in correspondence.pairs]
    workcell, settings = context.workcell, context.setting.settings
    # The servo brings the head itself onto a sphere: the arm goes beside its path by what the mount is off.
    sizes = ErrorSizes.stated(settings, workcell.calibrations.arm)
    scene = planning_scene_of(context).with_reserve(sizes.tool_mm)
    setting = ArmSetting(
        kinematics=workcell.arm.kinematics,
        robot_from_ct=correspondence.robot_from_ct.transform,
        flange_from_tool=workcell.flange_from(MountedTool.GUIDE),
        strategy=context.clinical.strategy,
        flange_from_stereo=workcell.flange_from(MountedTool.STEREO_HEAD),
        start_rad=context.result(CheckedSetUp).home_rad,
        limits=workcell.arm.limits(),
        approach_mm=settings.approach_mm,
        scene=scene,
        sizes=sizes,
        gauge_rad=radians6(*workcell.tools.guide.gauge.joints_deg),
    )
    context.progress(0.0, "checking every path")
    search = PathSearch(
        context,
        setting,
        localization.centres_mm[matched],
        StereoSight.of(workcell.calibrations.stereo_head),
    )
    held = held_trajectories(plan.plan, workcell.tools.guide.bore)
    turned = search.paths([one for one in held if one.identifier in context.remaining])
    check = turned.check
    motions = previews_of(setting, scene, check, turned.axes.targeted)
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
            largest_move_rad=max(move.largest_rad for move in check.moves),
            motions=tuple(MotionPreview.of(motion) for motion in motions),
            localizations=_localizations(check, matched),
            targets=_targets(check, setting),
            left_out=search.left_out,
        ),
        summary=f"{len(check.reached)} poses in one branch"
        + _closest(motions)
        + _turns(turned)
        + "".join(f"; {name} by {strategy}" for name, strategy in (chosen | replaced).items())
        + "".join(f"; without {name}" for name in search.left_out),
    )


def _closest(motions: Sequence[PreviewedMotion]) -> str:
    closest = [motion.preview.closest for motion in motions]
    distances = [one.distance_mm for one in closest if one is not None]
    return f", smallest clearance {min(distances):.0f} mm" if distances else ""


def _turns(turned: TurnedPaths) -> str:
    turns = [
        f"{name} turned by {math.degrees(turn):+.0f} deg" for name, turn in turned.turns_rad.items() if turn
    ]
    return f"; {', '.join(turns)}" if turns else ""


def _localizations(check: PathCheck, matched: list[int]) -> dict[str, tuple[LocalizationPose, ...]]:
    poses: dict[str, tuple[LocalizationPose, ...]] = {}
    for reached in check.reached:
        visit = reached.visit
        if visit.kind is VisitKind.LOCALIZATION and visit.fiducial is not None:
            pose = LocalizationPose(
                fiducial=matched[visit.fiducial],
                tool_pose=FramedPose.of(visit.pose),
                approach_rad=reached.approach_rad,
                joints_rad=reached.at_rad,
            )
            poses[visit.trajectory] = (*poses.get(visit.trajectory, ()), pose)
    return poses


def _targets(check: PathCheck, setting: ArmSetting) -> dict[str, TargetPose]:
    return {
        reached.visit.trajectory: TargetPose(
            tool_pose=FramedPose.of(reached.visit.pose),
            approach_rad=reached.approach_rad,
            joints_rad=reached.at_rad,
            approach_signs=arrival_signs(
                setting.kinematics, reached.visit.pose, reached.at_rad, setting.flange_from_tool
            ),
        )
        for reached in check.reached
        if reached.visit.kind is VisitKind.TARGET
    }


STEP = StepSpec(
    CheckedPaths,
    "Check every path",
    Phase.PREPARATION,
    run,
    reads=(Correspondence, CheckedSetUp, *READS),
    preconditions=localizable,
)
