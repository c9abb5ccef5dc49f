"""First looks at the skin, and the pose of the head by what they show alone.

The head is known roughly, as somebody has measured it, so the stereo head keeps its distance, and whole
pictures are read. The pose is searched over all turns: what was measured has no part in it, but a pose that
it excludes is refused. The mark of an entry tells left from right then, as the shape of a head hardly does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import FramedPose
from procedures.planning.motions import preview_motions
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.scene import PlanningScene
from procedures.planning.skin_tour import tour_views
from procedures.planning.skin_views import choose_views, mark_scannable
from procedures.planning.visits import ArmSetting, PathCheck, Reached
from procedures.registration.errors import HeadElsewhere
from procedures.registration.room_prior import RoomPrior
from procedures.registration.surface.checks import SurfaceLimits, require_start
from procedures.registration.surface.errors import (
    FAR_FROM_START,
    LITTLE_COVERAGE,
    MUCH_EXCLUDED,
    NO_STATIONS,
    NOTHING_LIT,
    OTHER_HEAD,
    POORLY_DETERMINED,
    TWO_POSES,
)
from procedures.registration.surface.global_search import difference
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.starts import Start, pose_of
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.surface_registration import SurfaceRegistration, register_surface
from procedures.steps.clinical.correspondence import MeasuredHead, SurfaceStart, SurveyedSkin
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.path_check import (
    CheckedPaths,
    LocalizationPose,
    MotionPreview,
    announce_motions,
    arm_setting_of,
)
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.relocalization import begin_looks
from procedures.steps.clinical.results import ScannedLook, join_lines
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surface.carried_head import find_carried, start_carried
from procedures.steps.clinical.surface.landmark_reading import prior_with_clamp
from procedures.steps.clinical.surface.look_scanner import (
    LEFT_OUT,
    SMALL_STEPS,
    LookScanner,
    is_dark_so_far,
    read_time_s,
    require_lines,
)
from procedures.steps.clinical.surface.repeated_work import Repeat, repeat_if_refused
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.clinical.surface.skin_pictures import tell_coverage
from procedures.steps.clinical.surface.surface_start import tell_site, touch_site
from procedures.steps.clinical.surroundings import READS
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.centring import Centring
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.text import format_count

VIEWS, FEWEST_VIEWS = 12, 6  # 8 patches of skin sufficed on six heads of the study
LOOK_S, SURVEY_S = 2.1, 60.0  # theatre time at a look, and of all with the ways to them
ACROSS_MM = (-9.0, 0.0, 9.0)  # places of the line across a look
WHOLE_PX = (2048, 1088)  # both whole sensors: skin up to 45 mm nearer or farther than expected
TURN_SD_RAD, PLACE_SD_MM = float(np.radians(1.5)), 2.5  # of the found pose, from the largest error below
# From the head, in addition to what a case keeps.
# Safety against a head that is nearer than it was measured. Source: twice what a tape errs (U).
ROUGH_MM = 30.0
# Predicted error at a target, with 95 %: the scan that follows is taken from there.
# Safety against first looks that leave the head undetermined. Source: a quarter of how far skin may be off
# for a look of the scan to show it (U).
LARGEST_ERROR_MM = 5.0
# Share of the head's surface above the jaw: less than of a scan, since the error above decides.
# Safety against a pose from two or three looks. Source: five looks of a whole case showed 0.05.
LEAST_COVERAGE = 0.04

OTHER_POSITION = (
    "Compare the patient's position, left and right included, and the frame on the clamp with the plan."
)
MEASURE_HEAD_AGAIN = Repeat(  # the arm does not go there again
    MeasuredHead,
    "The head may be elsewhere than it was measured, which is void: go on with the next step, which has it "
    "measured again.",
    (
        *(NO_STATIONS, NOTHING_LIT, LITTLE_COVERAGE, MUCH_EXCLUDED, POORLY_DETERMINED),
        *(TWO_POSES, OTHER_HEAD, FAR_FROM_START, HeadElsewhere),
    ),
)


def run(context: StepContext) -> Outcome[SurfaceStart]:
    """Take first looks, and find the head by them, or void what was measured.

    Raises SRF-002 to SRF-010, SRF-032, SRF-033, REG-013.
    """
    context.result(ImportedCt)
    measured = context.result(MeasuredHead)
    if (carried := find_carried(context)) is not None:
        return start_carried(carried)
    plan = context.result(CheckedPlan)
    with repeat_if_refused(context, MEASURE_HEAD_AGAIN):
        found, looked = _survey(context, measured, plan)
    lines = [line for one in looked for line in one.lines]
    pose, axes = found.robot_from_ct, HeadAxes.of(skin_of(context))
    turn_rad, place_mm = difference(
        pose_of(pose), pose_of(measured.robot_from_ct.transform), np.asarray(pose.apply(axes.centre_mm))
    )
    site = touch_site(context, plan, pose, axes)
    used_mm = found.residuals_mm[~found.excluded]
    shown = len({line.look for line in lines})
    return Outcome(
        SurfaceStart.without_spheres(
            pose,
            turn_sd_rad=TURN_SD_RAD,
            place_sd_mm=PLACE_SD_MM,
            site=site,
            survey=SurveyedSkin(
                looks=shown,
                lines=len(lines),
                points=len(found.points_mm),
                coverage=found.coverage,
                rms_mm=float(np.sqrt(np.mean(used_mm**2))),
                from_measured_mm=place_mm,
                from_measured_rad=turn_rad,
                theatre_s=sum(one.theatre_s for one in looked),
            ),
        ),
        summary=f"found by {format_count(shown, 'look')}, {format_count(len(lines), 'line')}, "
        f"{tell_coverage(found.coverage, 'these looks')}, {place_mm:.0f} mm and "
        f"{np.degrees(turn_rad):.0f} deg from where it was measured{tell_site(site)}",
    )


def _survey(
    context: StepContext, measured: MeasuredHead, plan: CheckedPlan
) -> tuple[SurfaceRegistration, tuple[ScannedLook, ...]]:
    """Return the head by first looks, and the looks."""
    setting = arm_setting_of(context)
    assert setting.scene is not None  # a case always checks clearance
    scene = setting.scene.around_rough_head(ROUGH_MM)
    setting = replace(setting, scene=scene)
    context.progress(0.0, "choosing first looks at the skin")
    looked = _look(context, setting, scene, choose_looks(context, setting))
    context.progress(0.9, "searching the head by what the looks show")
    scan = join_lines([line for one in looked for line in one.lines])
    targets_mm = np.array([one.target_mm for one in plan.plan.trajectories])
    prior = prior_with_clamp(context)
    return find_head(scan, skin_of(context), measured.start, targets_mm, prior), looked


def choose_looks(context: StepContext, setting: ArmSetting) -> tuple[Reached, ...]:
    """Choose looks spread over the skin, in the order of a short way. Raises SRF-033."""
    skin = skin_of(context)
    scanned = mark_scannable(skin)
    branch = setting.kinematics.branch_of(setting.start_rad)
    views = choose_views(setting, branch, skin.points_mm[scanned], skin.normals[scanned], VIEWS)
    tour = tour_views(setting, views, FEWEST_VIEWS, LOOK_S, SURVEY_S)
    if len(tour) < FEWEST_VIEWS:
        raise NO_STATIONS(
            f"the arm can look at few places on the skin and keep {ROUGH_MM:g} mm more than usual from it",
            limit=f"{FEWEST_VIEWS} looks",
            got=str(len(tour)),
        )
    return tuple(
        replace(one, visit=replace(one.visit, name=PoseName(PoseKind.FIDUCIAL, SKIN, number)))
        for number, one in enumerate(tour)
    )


def _look(
    context: StepContext, setting: ArmSetting, scene: PlanningScene, looks: Sequence[Reached]
) -> tuple[ScannedLook, ...]:
    """Return all looks, with the arm home again. Raises SRF-032."""
    workcell = context.workcell
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    branch = setting.kinematics.branch_of(setting.start_rad)
    check = PathCheck(branch, tuple(looks), ())
    previews = [MotionPreview.of(one) for one in preview_motions(setting, scene, check, ())]
    centring = Centring(workcell, ONE_SIDE, WHOLE_PX, setting.approach_mm)
    with workcell.master.supervised.announce_step_motions(announce_motions(previews, SMALL_STEPS)):
        around = scene.with_stereo_head(
            setting.robot_from_ct, workcell.master.flange_from(MountedTool.STEREO_HEAD)
        )
        workcell.master.surround(around, looks[len(looks) // 2].at_rad)
        begin_looks(context, "before the first looks at the skin", CheckedPaths)
        workcell.sensors.read_whole()
        looked = take_looks(context, looks, centring)
        _go_home(workcell, centring)
    check_room(context, "after the first looks at the skin")
    workcell.record_scanned_look(_name_of(context), None)
    dark = {str(one.number + 1): one.reason for one in looked if not one.lines}
    for name, reason in dark.items():
        context.find(f"first look {name} at the skin shows no line: {reason}")
    require_lines(looked, len(looks))
    return looked


def take_looks(context: StepContext, looks: Sequence[Reached], centring: Centring) -> tuple[ScannedLook, ...]:
    """Take the looks that are not kept, each on disk before the next. One that shows no line is not kept."""
    workcell, name = context.workcell, _name_of(context)
    kept = [ScannedLook.model_validate(one) for one in workcell.scanned_looks(name)]
    if kept:
        context.find(f"{len(kept)} of {len(looks)} first looks are kept from before the interruption")
    done = {one.number: one for one in kept}
    for number, one in enumerate(looks):
        if number in done:
            continue
        context.progress(0.1 + 0.8 * number / len(looks), f"first look {number + 1} of {len(looks)}")
        began_s = read_time_s(workcell)  # after a pause
        scanner = LookScanner(context, number, _as_look(number, one), centring, ACROSS_MM)
        lines = tuple(scanner.scan())
        theatre_s = read_time_s(workcell) - began_s
        reason = {"reason": scanner.reason, "code": scanner.code}
        done[number] = ScannedLook(number=number, lines=lines, **reason, theatre_s=theatre_s)
        if lines:
            workcell.record_scanned_look(name, done[number].model_dump(mode="json"))
        if is_dark_so_far(tuple(done.values()), len(looks), FEWEST_VIEWS):
            break
    return tuple(done[number] for number in sorted(done))


def _name_of(context: StepContext) -> str:
    """Return the name under which looks are kept: a measured head, which is void once something has moved."""
    return context.identifier(MeasuredHead)


def _go_home(workcell: Workcell, centring: Centring) -> None:
    """Bring the arm home; a way back that is not clear must not lose what the looks have shown."""
    if centring.is_over_sphere:
        try:
            centring.back_off()
        except RonnaError as problem:
            if not is_error(problem, *LEFT_OUT):
                raise
    workcell.master.return_home()


def _as_look(number: int, reached: Reached) -> LocalizationPose:
    return LocalizationPose(
        fiducial=number,
        tool_pose=FramedPose.of(reached.visit.pose),
        approach_rad=reached.approach_rad,
        joints_rad=reached.at_rad,
        approach_signs=ONE_SIDE,
    )


def find_head(
    scan: SurfaceScan, skin: Surface, measured: Start, targets_mm: Array, prior: RoomPrior
) -> SurfaceRegistration:
    """Register first looks by themselves. Raises SRF-002 to SRF-010, and REG-013 if the plan excludes it."""
    limits = SurfaceLimits(least_coverage=LEAST_COVERAGE, largest_error_mm=LARGEST_ERROR_MM)
    found = register_surface(scan, skin, targets_ct_mm=targets_mm, limits=limits)
    require_start(pose_of(found.robot_from_ct), measured, HeadAxes.of(skin))
    middle_mm = np.asarray(found.robot_from_ct.apply(prior.sight.centre_mm))
    if objection := prior.check_position(found.robot_from_ct.rotation_matrix, middle_mm):
        raise HeadElsewhere(f"by the first looks {objection}", action=OTHER_POSITION)
    return found


STEP = StepSpec(
    SurfaceStart,
    "Find the head by first looks at the skin",
    Phase.PREPARATION,
    run,
    reads=(ImportedCt, *ROOM_READS, CheckedSetUp, *READS),
    moves=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
