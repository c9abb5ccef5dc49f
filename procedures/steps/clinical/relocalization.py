"""Fine localization of every matched sphere by visual servo, in the strategy's orientation.

The tool centre is moved onto a sphere until the residual is below the tolerance; recorded is the nominal tool
pose plus the last residual. A sphere is expected where the localization before found it, else at its coarse
position, displaced by what the sphere before it was off by. That offset is checked first: a wrong sphere must
not lead the head on.

If the strategy asks for it, each joint arrives at every look as it will at the target. Backlash is then equal
in all of them and cancels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.relocalization.triangulation import check_head
from procedures.room.sighting import Tracked
from procedures.steps.branches import FEWEST_SPHERES, LEAVE_OUT, SPHERE_FAILED
from procedures.steps.clinical.guide_load import note_unloaded
from procedures.steps.clinical.path_check import (
    CheckedPaths,
    LocalizationPose,
    announce_motions,
    motions_over_spheres,
)
from procedures.steps.clinical.results import LeftOutSphere, Relocalization
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool
from procedures.workcell.centring import CentredSphere, Centring
from procedures.workcell.stereo_look import pair_picture
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.text import format_against_limit

SMALL_STEPS = "the small steps over each sphere, or in search of one that is not seen"
# Safety against a sphere taken for another. Source: chi distribution of three axes.
SIGMAS = 4.0  # per axis; an error in space is longer in 1 of 1,000 cases


def run(context: StepContext) -> Outcome[Relocalization]:
    """Localize all matched spheres. Raises PRO-008 for a missing sphere, PRO-009, STE-014."""
    paths = context.result(CheckedPaths)
    motions = motions_over_spheres(paths.motions, context.key.trajectory)
    announced = announce_motions(motions, SMALL_STEPS) if motions else None
    with context.workcell.master.supervised.announce_step_motions(announced):
        context.workcell.master.mount.check(MountedTool.STEREO_HEAD)
        planned = paths.looks_for(context.key.trajectory)
        surround_stereo_head(context, planned[len(planned) // 2][1].joints_rad)
        begin_looks(context, "before the spheres are localized again", Relocalization)
        return localize_spheres(context, paths)


def localize_spheres(context: StepContext, paths: CheckedPaths) -> Outcome[Relocalization]:
    """Localize the spheres of this localization, once looks have begun. Raises as `run`."""
    planned = paths.looks_for(context.key.trajectory)
    learns = find_strategy(paths.strategy).learns_arm
    workcell, settings = context.workcell, context.setting.settings

    def look(fiducial: int) -> None:  # in the very pose: the local errors of the arm show in it
        check_room(context, f"over sphere {fiducial + 1}", sides={Tracked.ARM: centring.arriving})
        note_unloaded(context)

    centring = Centring(
        workcell,
        arriving=None,
        area_px=settings.servo_area_px,
        approach_mm=settings.approach_mm,
        on_centred=look,
    )
    expected_mm = _expect_offsets(context, [item for _, item in planned])
    shift_mm = np.zeros(3)  # of the last sphere from where it was expected
    offsets_mm: list[Array] = []
    spheres: list[CentredSphere] = []
    axes: list[str] = []
    left_out: list[LeftOutSphere] = []
    for number, (axis, item) in enumerate(planned):
        context.progress(number / len(planned), f"centring sphere {item.fiducial + 1}")
        centring = replace(centring, arriving=arriving(context, paths, item))
        coarse = item.tool_pose.transform
        ahead_mm = expected_mm.get(item.fiducial, np.zeros(3)) + shift_mm
        if ahead_mm.any():  # the pose is displaced, and so is the head that the arm must clear
            surround_stereo_head(context, item.joints_rad, offset_mm=ahead_mm)
        try:
            sphere = centring.centre_on(
                item.fiducial, coarse.displace(ahead_mm), item.approach_rad, is_close=axis in axes
            )
        except RonnaError as problem:
            if not is_error(problem, *SPHERE_FAILED.errors):
                raise
            check_room(context, f"without sight of sphere {item.fiducial + 1}")  # the cart may have left
            others = {one.fiducial for one in spheres} | {one.fiducial for _, one in planned[number + 1 :]}
            if item.fiducial in others:
                context.find(
                    f"one look at sphere {item.fiducial + 1} failed, {problem.summary}; others of it remain"
                )
            else:
                left_out.append(_exclude_sphere(context, item.fiducial, problem, len(others)))
            centring.back_off()
            continue
        name = f"stereo-{context.key.trajectory or (axis if learns else 'all')}-{item.fiducial + 1}.png"
        context.keep_picture(name, pair_picture(sphere.last_look))
        offsets_mm.append(sphere.point_mm - coarse.translation_mm)
        shift_mm += sphere.point_mm - coarse.translation_mm - ahead_mm
        spheres.append(sphere)
        axes.append(axis)
        try:
            along = [place for place, one in enumerate(axes) if one == axis]  # the tool held alike
            _check_last(
                [offsets_mm[place] for place in along], [spheres[place].fiducial for place in along], context
            )
        except GateFailed:
            centring.back_off()
            check_room(context, f"over sphere {item.fiducial + 1}")  # names a cart or head that has moved
            raise
    if centring.is_over_sphere:
        centring.back_off()
    gaps_mm = tuple(sphere.ray_gap_mm for sphere in spheres)
    radii_mm = tuple(sphere.radii_mm for sphere in spheres)
    stated_mm = workcell.calibrations.stereo_head.stated_error_mm
    check_head(radii_mm, gaps_mm, stated_mm, settings.sphere_diameter_mm)
    check_room(context, "after the spheres were localized again")
    return Outcome(
        Relocalization(
            fiducials=tuple(sphere.fiducial for sphere in spheres),
            points_robot_mm=tuple(sphere.point_mm.tolist() for sphere in spheres),
            covariances_mm2=tuple(sphere.covariance_mm2.tolist() for sphere in spheres),
            residuals_mm=tuple(sphere.residuals_mm for sphere in spheres),
            ray_gaps_mm=gaps_mm,
            radii_mm=radii_mm,
            looks=tuple(sphere.looks for sphere in spheres),
            joints_rad=tuple(sphere.joints_rad for sphere in spheres),
            coarse_offset_mm=np.mean(offsets_mm, axis=0).tolist(),
            axes=tuple(axes) if learns else (),
            left_out=tuple(left_out),
        ),
        summary=(
            f"{len(spheres)} {'looks' if learns else 'spheres'}, largest final residual "
            f"{max(sphere.residuals_mm[-1] for sphere in spheres):.3f} mm"
        )
        + "".join(f"; without sphere {one.fiducial + 1}" for one in left_out),
    )


def begin_looks(context: StepContext, occasion: str, result: type[StepResult]) -> None:
    """Start arm and cameras; unless a `result` stands, the arm begins at home, seen there by the tracker.

    What moves from then on shows at home. Raises PRO-007.
    """
    workcell = context.workcell
    from_home = workcell.master.place.is_home or not context.stands(result)
    check_room(context, occasion)
    workcell.start(cameras=True)
    if not from_home:
        return
    workcell.master.return_home()
    if check_room(context, occasion, CAREFUL_FRAMES).base_mm is None:
        raise GateFailed(
            f"{occasion}, the tracker does not see the frame on the arm",
            expected=f"the frame in view, with {workcell.phrases.arms} home",
            action="Clear the line of sight between tracker and arm, then repeat the step.",
        )


def _expect_offsets(context: StepContext, planned: Sequence[LocalizationPose]) -> dict[int, Array]:
    """Return how far each sphere was last found from its coarse place, (3,) mm; empty unless all were.

    In another orientation the arm errs differently, but alike at all spheres: the coarse places scatter more.
    """
    last = context.latest(Relocalization)
    if last is None or not {item.fiducial for item in planned} <= set(last.fiducials):
        return {}
    points_mm = dict(zip(last.fiducials, np.array(last.points_robot_mm), strict=True))
    return {
        item.fiducial: points_mm[item.fiducial] - item.tool_pose.transform.translation_mm for item in planned
    }


def arriving(context: StepContext, paths: CheckedPaths, look: LocalizationPose) -> tuple[int, ...] | None:
    """Return each joint's approach direction at a look, or None if the strategy leaves it open.

    It is that in which the joint will arrive at the target. If one registration serves all targets, a
    calibrated arm arrives from one side: its known backlash helps only if the side is known as well.
    """
    if look.approach_signs is not None:
        return look.approach_signs
    if context.key.trajectory is None and context.workcell.calibrations.arm is not None:
        return ONE_SIDE
    if (
        context.key.trajectory is None
        or not find_strategy(paths.strategy_of(context.trajectory)).controls_approach
    ):
        return None
    return paths.targets[context.trajectory].approach_signs


def _exclude_sphere(context: StepContext, fiducial: int, problem: RonnaError, remain: int) -> LeftOutSphere:
    """Ask to leave out a sphere. Raises `problem` if the operator declines or too few would remain."""
    if remain < FEWEST_SPHERES:
        raise problem
    question = SPHERE_FAILED.question(
        f"sphere {fiducial + 1} cannot be measured",
        f"{problem.summary}; {remain} spheres would remain without it",
        context.key.trajectory,
    )
    if context.choose(question) != LEAVE_OUT:
        raise problem
    return LeftOutSphere(fiducial=fiducial, reason=problem.summary)


def _check_last(offsets_mm: Sequence[Array], fiducials: Sequence[int], context: StepContext) -> None:
    """Raise PRO-007 if the last sphere's offset is inconsistent: wrong sphere, or the patient has moved.

    The spheres share the error of tool frame and tracker frame, which alone bounds the first offset.
    """
    *before, last = offsets_mm
    limit_mm = context.setting.settings.coarse_fine_limit_mm
    *others, name = (f"sphere {one + 1}" for one in fiducials)
    if not before:
        limit_mm += _shared_error_mm(context)
        before = [np.zeros(3)]
    elif len(before) == 1:  # it is unknown which of the two is wrong
        name = f"{others[0]} or {name}"
    apart_mm = max(math.dist(last, one) for one in before)
    if apart_mm > limit_mm:
        raise GateFailed(
            f"{name} is not where the tracker saw it",
            limit=f"{limit_mm:.3g} mm",
            got=f"{format_against_limit(apart_mm, limit_mm, 2)} mm",
            action="Check that the patient has not moved, then localize with the tracker again.",
        )


def _shared_error_mm(context: StepContext) -> float:
    """Return a bound (mm) on coarse position errors due to tool frame and tracker frame.

    Tracker and stereo head look in different orientations, so the error counts at most twice.
    """
    records = context.workcell.calibrations
    tool_mm = ErrorSizes.stated(context.setting.settings, records.arm).tool_mm
    return 2.0 * SIGMAS * math.hypot(tool_mm, records.tracker_frame.stated_error_mm)


STEP = StepSpec(
    Relocalization,
    "Re-localize the spheres with the stereo head",
    Phase.OPERATION,
    run,
    scope=Scope.LOCALIZATION,
    reads=(CheckedPaths, *ROOM_READS, *READS),
    moves=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
