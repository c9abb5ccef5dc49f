"""Scan of the skin: at each look the projector's line in a few places across, seen by the stereo head.

The points are kept in the robot frame by the nominal tool pose, with the number of the look: what the arm
errs there its points share, and the registration accounts for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.events import ScanProgress
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.steps.clinical.correspondence import SurfaceStart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.path_check import (
    CheckedPaths,
    announce_motions,
    motions_over_spheres,
)
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.relocalization import arriving, begin_looks, localize_spheres
from procedures.steps.clinical.results import ScannedLine, ScannedLook, ScannedSurface
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.surface.look_scanner import (
    SMALL_STEPS,
    LookScanner,
    describe_short,
    has_gone_out,
    is_dark_so_far,
    read_time_s,
    require_line_to_the_end,
    require_lines,
)
from procedures.steps.clinical.surface.scan_coverage import ScanCoverage, describe_scan
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.clinical.surface.skin_pictures import COVERAGE_PICTURE, draw_coverage, tell_coverage
from procedures.steps.clinical.surface.surface_paths import FEWEST_VIEWS
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.skin_looks import SKIN
from procedures.workcell import MountedTool
from procedures.workcell.centring import Centring
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

LINE_AREA_PX = (832, 1088)  # all rows, along the line; skin up to 19 mm nearer or farther than expected
OF_LINES = (
    "lines",
    "planned_looks",
    "dark",
    "covered",
    "theatre_s",
    "kept_looks",
    "progress",
)  # of the result


def run(context: StepContext) -> Outcome[ScannedSurface]:
    """Scan the skin from all looks of the path check, once for all trajectories, and localize the spheres.

    Raises SRF-032 if no look shows a line, or none any more, PRO-007, and for spheres PRO-008, PRO-009,
    STE-014.
    """
    paths = context.result(CheckedPaths)
    before = None  # the scan of another trajectory; who repeats this step has the skin scanned again
    if not context.done_before:
        void = [one.result.lines for one in context.former(ScannedSurface)]  # those of a finished one stand
        before = context.result_among(
            ScannedSurface, lambda found: next((one for one in found if one.lines not in void), None)
        )
    own = context.key.trajectory
    axes = [own] if own is None or before is not None else [SKIN, own]
    motions = [one for axis in axes for one in motions_over_spheres(paths.motions, axis)]
    announced = announce_motions(motions, SMALL_STEPS) if motions else None
    with context.workcell.master.supervised.announce_step_motions(announced):
        return _look(context, paths, before)


def _look(
    context: StepContext, paths: CheckedPaths, before: ScannedSurface | None
) -> Outcome[ScannedSurface]:
    """Take all looks of this localization; lines of a scan `before` serve again."""
    context.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    at_spheres = [one for _, one in paths.looks_for(context.key.trajectory)]
    looks = at_spheres if before is not None else paths.skin_looks
    surround_stereo_head(context, looks[len(looks) // 2].joints_rad)
    begin_looks(context, "before the skin is scanned", ScannedSurface)
    scanned = _scan(context, paths) if before is None else Outcome(before, "the skin is scanned already")
    if not at_spheres:
        context.workcell.record_scanned_look(_name_of(context), None)
        return scanned
    surround_stereo_head(context, at_spheres[len(at_spheres) // 2].joints_rad)
    spheres = localize_spheres(context, paths)
    context.workcell.record_scanned_look(_name_of(context), None)
    lines = {name: getattr(scanned.result, name) for name in OF_LINES}
    return Outcome(
        ScannedSurface.beside(spheres.result, **lines), summary=f"{scanned.summary}; {spheres.summary}"
    )


def _scan(context: StepContext, paths: CheckedPaths) -> Outcome[ScannedSurface]:
    context.result(ImportedCt)
    planned, workcell = paths.skin_looks, context.workcell
    workcell.sensors.read_around_tool(LINE_AREA_PX)
    kept = [ScannedLook.model_validate(one) for one in workcell.scanned_looks(_name_of(context))]
    if kept:
        context.find(f"{len(kept)} of {len(planned)} looks at the skin are kept from before the interruption")
    looks, state = _take_looks(context, paths, kept)
    dark = {str(one.number + 1): one.reason for one in looks if not one.lines}
    lines = [line for one in looks for line in one.lines]
    for number, reason in dark.items():
        context.find(f"look {number} at the skin shows no line: {reason}")
    require_lines(looks, len(planned))
    require_line_to_the_end(looks, len(planned))
    if (short := describe_short(lines)) is not None:
        context.find(short)
    over_skin = Centring(workcell, None, LINE_AREA_PX, context.setting.settings.approach_mm)
    if over_skin.is_over_sphere:
        over_skin.back_off()
    check_room(context, "after the skin was scanned")
    points_mm = _points_in_ct(context, lines)
    covered, picture = draw_coverage(skin_of(context), points_mm, np.reshape(state.missing_mm, (-1, 3)))
    context.keep_picture(COVERAGE_PICTURE, picture)
    return Outcome(
        ScannedSurface.without_spheres(
            lines=lines,
            planned_looks=len(planned),
            dark=dark,
            covered=covered,
            theatre_s=sum(one.theatre_s for one in looks),
            kept_looks=len(kept),
            progress=state,
        ),
        summary=f"{format_count(len(lines), 'line')}, {format_count(len(points_mm), 'point')}, "
        f"{tell_coverage(covered, context.result(SurfaceStart).placed_by)}"
        + (f"; {format_count(len(dark), 'look shows', 'looks show')} no line" if dark else ""),
    )


def _name_of(context: StepContext) -> str:
    """Return the name under which looks are kept: a path check, which is void once something has moved."""
    return context.identifier(CheckedPaths)


def _take_looks(
    context: StepContext, paths: CheckedPaths, kept: Sequence[ScannedLook]
) -> tuple[tuple[ScannedLook, ...], ScanProgress]:
    """Take the looks that are not kept, each on disk before the next, and return all with the scan's state.

    One that shows no line is not kept.
    """
    planned, workcell, plan = paths.skin_looks, context.workcell, context.result(CheckedPlan)
    start = context.result(SurfaceStart)
    ct_from_robot = start.robot_from_ct.transform.inverse()
    paired = [fiducial for fiducial, _ in start.pairs]
    coverage = ScanCoverage(
        skin_of(context),
        ct_from_robot.apply([one.tool_pose.transform.translation_mm for one in planned]),
        {target: plan.trajectory(target).target_mm for target in context.served_trajectories},
        context.result(LocalizedFiducials).centres_mm[paired] if paired else (),
    )
    looks = list(kept)
    for one in kept:
        coverage.add(_points_in_ct(context, one.lines))
    taken = {one.number for one in kept}
    for number in (place for place in range(len(planned)) if place not in taken):
        state = coverage.after(len(planned))
        context.progress(len(looks) / len(planned), describe_scan(state), state)
        began_s = read_time_s(workcell)  # after a pause
        sides = arriving(context, paths, planned[number])
        centring = Centring(workcell, sides, LINE_AREA_PX, context.setting.settings.approach_mm)
        scanner = LookScanner(context, number, planned[number], centring)
        lines = tuple(scanner.scan())
        theatre_s = read_time_s(workcell) - began_s
        reason = {"reason": scanner.reason, "code": scanner.code}
        looks.append(ScannedLook(number=number, lines=lines, **reason, theatre_s=theatre_s))
        if lines:
            workcell.record_scanned_look(_name_of(context), looks[-1].model_dump(mode="json"))
        coverage.add(_points_in_ct(context, lines))
        if is_dark_so_far(looks, len(planned), FEWEST_VIEWS) or has_gone_out(looks):
            break
    state = coverage.after(len(planned))
    context.progress(1.0, describe_scan(state), state)
    return tuple(looks), state


def _points_in_ct(context: StepContext, lines: Sequence[ScannedLine]) -> Array:
    """Return the points (n, 3) of lines in the CT, by the start of the registration."""
    ct_from_robot = context.result(SurfaceStart).robot_from_ct.transform.inverse()
    points_mm = [point for line in lines for point in line.points_mm]
    return np.asarray(ct_from_robot.apply(points_mm)) if points_mm else np.empty((0, 3))


STEP = StepSpec(
    ScannedSurface,
    "Scan the skin with the stereo head",
    Phase.OPERATION,
    run,
    scope=Scope.LOCALIZATION,
    reads=(ImportedCt, CheckedPaths, SurfaceStart, *ROOM_READS, *READS),
    moves=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
