"""Scan of the skin: at each look the projector's line in a few places across, seen by the stereo head.

The points are kept in the robot frame by the nominal tool pose, with the number of the look: what the arm
errs there its points share, and the registration accounts for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.registration.surface.errors import NOTHING_LIT
from procedures.relocalization.triangulation import camera_model
from procedures.room.sighting import Tracked
from procedures.steps.clinical.correspondence import SurfaceStart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.path_check import (
    CheckedPaths,
    LocalizationPose,
    announce_motions,
    motions_over_spheres,
)
from procedures.steps.clinical.relocalization import arriving, begin_looks, localize_spheres
from procedures.steps.clinical.results import UPPER, ScannedLine, ScannedSurface
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.surface.coverage_picture import draw_coverage
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.skin_looks import SKIN
from procedures.workcell import MountedTool
from procedures.workcell.centring import Centring
from procedures.workcell.line_look import LineLook
from ronna_hw.arm.errors import NotClear, OutOfJointRange, Singular, Unreachable
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.vectors import vector3

ACROSS_MM = (-9.0, -3.0, 3.0, 9.0)  # places of the line across a look, along the tool's y axis
LINE_AREA_PX = (832, 1088)  # all rows, along the line; skin up to 19 mm nearer or farther than expected
CHECKED_LOOKS = 3  # between two looks at which the tracker looks at the room; the guards watch all motions
DECIMALS = 4  # of a point in the record, mm
SMALL_STEPS = "the small steps across each place on the skin"
OF_LINES = ("lines", "planned_looks", "dark", "covered", "theatre_s")  # of the result
LEFT_OUT = (NotClear, OutOfJointRange, Singular, Unreachable)


def run(context: StepContext) -> Outcome[ScannedSurface]:
    """Scan the skin from all looks of the path check, once for all trajectories, and localize the spheres.

    Raises SRF-032 if no look shows a line, PRO-007, and for spheres PRO-008, PRO-009, STE-014.
    """
    paths = context.result(CheckedPaths)
    before = None  # the scan of another trajectory; who repeats this step has the skin scanned again
    if not context.done_before:
        before = context.result_among(ScannedSurface, lambda found: found[0] if found else None)
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
        return scanned
    surround_stereo_head(context, at_spheres[len(at_spheres) // 2].joints_rad)
    spheres = localize_spheres(context, paths)
    lines = {name: getattr(scanned.result, name) for name in OF_LINES}
    return Outcome(
        ScannedSurface.beside(spheres.result, **lines), summary=f"{scanned.summary}; {spheres.summary}"
    )


def _scan(context: StepContext, paths: CheckedPaths) -> Outcome[ScannedSurface]:
    context.result(ImportedCt)
    planned, workcell = paths.skin_looks, context.workcell
    workcell.sensors.read_around_tool(LINE_AREA_PX)
    began_s = workcell.clock.now_s()
    lines: list[ScannedLine] = []
    dark: dict[str, str] = {}
    offsets_mm: list[Array] = []
    for number, one in enumerate(planned):
        context.progress(number / len(planned), f"scanning the skin, look {number + 1} of {len(planned)}")
        scanner = _Scanner(context, number, one, arriving(context, paths, one))
        seen = scanner.scan()
        if not seen:
            dark[str(number + 1)] = scanner.reason
        lines += seen
        offsets_mm += [
            np.median(line.points_mm, axis=0) - one.tool_pose.transform.translation_mm for line in seen
        ]
    theatre_s = workcell.clock.now_s() - began_s
    for name, reason in dark.items():
        context.find(f"look {name} at the skin shows no line: {reason}")
    require_lines(lines, dark)
    scanner.back_off()
    check_room(context, "after the skin was scanned")
    points_mm = np.concatenate([line.points_mm for line in lines])
    in_ct = np.asarray(context.result(SurfaceStart).robot_from_ct.transform.inverse().apply(points_mm))
    covered, picture = draw_coverage(skin_of(context), in_ct)
    context.keep_picture("surface-coverage.png", picture)
    return Outcome(
        ScannedSurface.without_spheres(
            coarse_offset_mm=vector3(np.mean(offsets_mm, axis=0)),
            lines=lines,
            planned_looks=len(planned),
            dark=dark,
            covered=covered,
            theatre_s=theatre_s,
        ),
        summary=f"{len(lines)} lines, {len(points_mm)} points, {covered:.0%} of the skin above the jaw"
        + (f"; {len(dark)} looks show no line" if dark else ""),
    )


def require_lines(lines: Sequence[ScannedLine], dark: Mapping[str, str]) -> None:
    """Raise SRF-032 without any line; `dark` has the reasons by look."""
    if not lines:
        reason = next(iter(dark.values()), "") or "nothing"
        raise NOTHING_LIT(
            f"no look shows the line: {reason}", expected="a line", got=f"{len(dark)} dark looks"
        )


class _Scanner:
    """Scans one place on the skin: on to it, then across it in small steps."""

    def __init__(
        self, context: StepContext, number: int, look: LocalizationPose, sides: tuple[int, ...] | None
    ) -> None:
        self._context, self._number, self._look, self._sides = context, number, look, sides
        approach_mm = context.setting.settings.approach_mm
        self._centring = Centring(context.workcell, sides, LINE_AREA_PX, approach_mm)
        self.reason = ""

    def scan(self) -> list[ScannedLine]:
        """Return the lines that show, with `reason` for those that do not."""
        workcell, pose = self._context.workcell, self._look.tool_pose.transform
        lines: list[ScannedLine] = []
        for place, across_mm in enumerate(ACROSS_MM):
            here = pose.displace(pose.rotation_matrix[:, 1] * across_mm)
            try:
                self._centring.go_over(here, self._look.approach_rad)
            except RonnaError as problem:
                if not is_error(problem, *LEFT_OUT):
                    raise
                self.reason = problem.summary
                continue
            if place == 0 and self._number % CHECKED_LOOKS == 0:
                name = f"at look {self._number + 1}"
                check_room(self._context, name, sides={Tracked.ARM: self._sides})
            seen = workcell.look_at_line()
            if seen.points is None or not len(seen.points.points_mm):
                self.reason = "" if seen.problem is None else seen.problem.summary
            else:
                lines.append(self._record(seen))
        return lines

    def back_off(self) -> None:
        """Back off along the tool axis, if the arm is over the skin."""
        if self._centring.is_over_sphere:
            self._centring.back_off()

    def _record(self, seen: LineLook) -> ScannedLine:
        workcell, found = self._context.workcell, seen.points
        assert found is not None
        joints_rad = workcell.master.joints_rad()
        pose = workcell.master.tool_pose(joints_rad, self._sides)
        view_mm = camera_model(workcell.calibrations.stereo_head.left).centre_mm
        turn = pose.rotation_matrix
        return ScannedLine(
            look=self._number,
            joints_rad=joints_rad,
            view_mm=vector3(_rounded(pose.apply(view_mm))),
            points_mm=_rounded(pose.apply(found.points_mm)).tolist(),
            covariances_mm2=_upper(turn @ found.covariance_mm2 @ turn.T).tolist(),
        )


def _rounded(points_mm: Array) -> Array:
    return np.asarray(np.round(points_mm, DECIMALS))


def _upper(covariance_mm2: Array) -> Array:
    return np.asarray(covariance_mm2[:, UPPER[0], UPPER[1]])


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
