"""Check of a plan against its CT series, the fiducials found in it, and the arm's reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.errors import (
    MARKERS_ADHESIVE,
    NOT_THE_FRAME,
    NOT_THE_TEMPLATE,
    OUTSIDE_FIELD,
    STOP_BEYOND_INSTRUMENT,
    WRONG_ORIENTATION,
    WRONG_SERIES,
    NotReachable,
    UnknownTool,
    WrongMarkerCount,
    raise_together,
)
from procedures.planning.guide import find_stops_beyond_end, place_guides
from procedures.planning.head_in_ct import check_entry_path, check_standoff
from procedures.planning.plan_file import check_voxels
from procedures.planning.plan_model import FiducialKind, Plan
from procedures.planning.sign_check import doubt_signs, find_wrong_signs, fits_mirrored
from procedures.planning.structures import StructureDistance, check_structures, measure_distances
from procedures.registration import MatchStatus, match
from procedures.registration.errors import LayoutNotFound
from procedures.registration.template import find_layout, match_template
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM
from ronna_hw.text import format_against_limit
from ronna_hw.tool_record import GuideBore
from ronna_hw.x_frame import SPHERE_CENTRES_MM

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume
    from procedures.planning.head_in_ct import HeadEllipsoid
    from procedures.planning.line_of_sight import StereoSight
    from procedures.planning.motions import PreviewedMotion
    from procedures.planning.visits import ArmSetting, PathCheck, Unmet
    from procedures.strategies.strategy import Strategy
    from procedures.strategies.trajectory import Trajectory

LEAST_SIDE_DIFFERENCE_MM = 6.0  # in a triangle of fiducials: below it three points are often ambiguous
CT_SIGMA_MM = 0.10  # per axis: the localizer's error on a poor series, with margin
ROOM_SIGMA_MM = 0.56  # per axis: the coarsest tracker used in the correspondence study
CheckResult = tuple[list[RonnaError], list[str]]  # findings, warnings
WITHIN_ROUNDING_MM = 0.5  # resolution of the path check between two samples
FEWEST_THAT_TELL_A_MOVE = 4  # with three, a moved one cannot be identified
# Above it even a registration 3 mm off, as coarse as the tracker's, is refused at no target.
WIDE_MARGIN_MM, USUAL_MARGIN_MM = 5.0, 2.0
NEAR_STANDOFF_MM, USUAL_STANDOFF_MM = 10.0, 30.0  # 30 in centimetres is less
MOST_MISTYPED = 2  # characters in which a mistyped series UID differs
KNOWN_TOOLS = ("guide",)  # the only one in a theatre's calibration records


@dataclass(frozen=True)
class PlanCheck:
    """Result of a plan check. Any of the `findings` rejects the plan; `warnings` are left to the surgeon.

    If an arm was given and reaches everything, `motions` are those of the whole procedure, `turns_rad` has
    each trajectory's turn about its axis, and `paths` the joints; otherwise `unmet` names what it does not
    reach. `distances` are from every trajectory to every structure; `head` tells the sides of trajectories.
    `sign_doubt` says why the coordinates may not be LPS; it is among the warnings too. `only_side_tells` is
    true if the plan mirrored left and right fits the CT as well.
    """

    plan: Plan
    findings: tuple[RonnaError, ...]
    warnings: tuple[str, ...]
    motions: tuple[PreviewedMotion, ...] = ()
    turns_rad: tuple[tuple[str, float], ...] = ()
    paths: PathCheck | None = None
    unmet: tuple[Unmet, ...] = ()
    distances: tuple[StructureDistance, ...] = ()
    head: HeadEllipsoid | None = None
    sign_doubt: str = ""
    only_side_tells: bool = False

    @property
    def passed(self) -> bool:
        """Whether the plan has no findings."""
        return not self.findings

    def require(self) -> None:
        """Raise the finding, or one error that lists several. Do nothing if there are none."""
        raise_together(self.findings, "the plan")

    def as_payload(self) -> dict[str, Any]:
        """Return plain values for a record or a script."""
        return {
            "passed": self.passed,
            "series_instance_uid": self.plan.series_instance_uid,
            "trajectories": [
                {
                    "id": one.id,
                    "side": self.head and self.head.side_of(one.entry_mm, one.target_mm),
                    "depth_mm": round(one.depth_mm, 3),
                    "margin_mm": one.margin_mm,
                }
                for one in self.plan.trajectories
            ],
            "findings": [{"code": one.code, "what": one.what, "action": one.advice} for one in self.findings],
            "warnings": list(self.warnings),
            "only_side_tells": self.only_side_tells,
            "motions": [motion.as_payload() for motion in self.motions],
            "free_angle_turns_rad": dict(self.turns_rad),
            "structures": [
                {
                    "name": one.structure,
                    "trajectory": one.trajectory,
                    "distance_mm": round(one.distance_mm, 3),
                    "margin_mm": one.margin_mm,
                }
                for one in self.distances
            ],
        }


def require_spheres(plan: Plan) -> None:
    """Raise PLAN-030 if the plan's markers are adhesive, so that no case can register by them."""
    for finding in _check_kind(plan):
        raise finding


def _check_kind(plan: Plan) -> list[RonnaError]:
    if plan.fiducials is not FiducialKind.ADHESIVE:
        return []
    wrong = MARKERS_ADHESIVE(
        f"the plan has {plan.implanted} adhesive markers, which only the CT shows",
        expected=f'fiducials = "{FiducialKind.FREE}" or "{FiducialKind.XFRAME}"',
        got=f'fiducials = "{plan.fiducials}"',
    )
    return [wrong]


def check_plan(
    plan: Plan,
    volume: Volume,
    *,
    fiducials_mm: ArrayLike | None = None,
    to_fiducials: bool = True,
    arm: ArmSetting | None = None,
    sight: StereoSight | None = None,
    bore: GuideBore | None = None,
    plan_name: str = "plan",
    ct_name: str = "CT",
) -> PlanCheck:
    """Check a plan against its CT series and, if given, fiducials (n, 3) in LPS mm, arm and guide.

    Without `to_fiducials` they are counted, but the arm's motions to them are omitted. With `sight` the arm
    may turn trajectories about their axes, as the procedure does, so that the stereo head sees the fiducials
    and all motions are clear. The names are those of file and folder, for messages.

    Never raises for an invalid plan: all findings are returned together; `PlanCheck.require` raises them.
    """
    findings: list[RonnaError] = [
        *_check_kind(plan),
        *_check_tool(plan),
        *([] if bore is None else _check_instrument(plan, bore)),
    ]
    warnings = [
        f"trajectory {one.id}.margin_mm: {one.margin_mm:g} mm would accept a bad registration; "
        f"{USUAL_MARGIN_MM:.1f} is usual"
        for one in plan.trajectories
        if one.margin_mm > WIDE_MARGIN_MM
    ]
    if plan.standoff_mm < NEAR_STANDOFF_MM:
        warnings.append(
            f"standoff_mm: {plan.standoff_mm:g} mm holds the guide close to the skin; {USUAL_STANDOFF_MM:g} "
            "is usual; give millimetres, not centimetres"
        )
    distances = measure_distances(plan)
    for found, warned in (
        _check_series(plan, volume, plan_name, ct_name),
        _check_patient(plan, volume),
        check_structures(plan, distances, volume),
    ):
        findings += found
        warnings += warned
    if sign_doubt := "" if findings else doubt_signs(plan, volume):
        warnings.append(sign_doubt)
    if fiducials_mm is not None and plan.fiducials is not FiducialKind.ADHESIVE:
        found, warned = _check_fiducials(plan, np.asarray(fiducials_mm, dtype=float).reshape(-1, 3))
        findings += found
        warnings += warned
    check = PlanCheck(
        plan,
        (),
        (),
        distances=distances,
        sign_doubt=sign_doubt,
        only_side_tells=not findings and fits_mirrored(plan, volume),
    )
    if arm is not None:
        guided = tuple(one.trajectory for one in plan.trajectories)
        guided = guided if bore is None else place_guides(plan, bore)
        check = _check_arm(check, guided, fiducials_mm if to_fiducials else None, arm, sight)
        findings += check.findings
        warnings += (*check.warnings, *_warn_close_at_start(check.motions))
    return replace(check, findings=tuple(findings), warnings=tuple(warnings))


def _check_series(plan: Plan, volume: Volume, plan_name: str, ct_name: str) -> CheckResult:
    """Check that the plan belongs to this series and that every trajectory leads into the head."""
    if plan.series_instance_uid != volume.series_instance_uid:
        wrong = WRONG_SERIES(
            f"the plan belongs to another CT series{_first_difference(plan, volume)}",
            expected=f"{plan.series_instance_uid} ({plan_name})",
            got=f"{volume.series_instance_uid} ({ct_name})",
        )
        return [wrong], []
    altered = check_voxels(plan, volume)
    unlike: list[RonnaError] = [] if altered is None else [altered]
    if outside := _find_points_outside(plan, volume):
        return [*_add_other_signs(plan, volume, outside), *unlike], []
    if unlike:
        return unlike, []
    into_head = [check_entry_path(volume, one) for one in plan.trajectories]
    findings = _add_other_signs(plan, volume, [finding for finding, _ in into_head if finding])
    in_skin = [check_standoff(volume, one, plan.standoff_mm) for one in plan.trajectories]
    findings += [finding for finding in in_skin if finding]
    return findings, [warning for _, warning in into_head if warning]


def _add_other_signs(plan: Plan, volume: Volume, findings: list[RonnaError]) -> list[RonnaError]:
    """Add to findings about where a plan lies that it would fit in other signs, if it would."""
    wrong = find_wrong_signs(plan, volume) if findings else None
    return findings if wrong is None else [*findings, wrong]


def _check_patient(plan: Plan, volume: Volume) -> CheckResult:
    """Check the patient position, and warn if there are too few fiducials to detect a displaced one."""
    findings: list[RonnaError] = []
    warnings: list[str] = []
    if not volume.patient_position:
        warnings.append("the series does not give the patient position; check left and right by eye")
    elif volume.patient_position != plan.patient_orientation.value:
        findings.append(
            WRONG_ORIENTATION(
                "the CT was taken in a different patient position",
                expected=f"{plan.patient_orientation.value} (patient_orientation of the plan)",
                got=f"{volume.patient_position} (of the CT)",
            )
        )
    if plan.implanted < FEWEST_THAT_TELL_A_MOVE and not plan.fiducials.has_skin:  # which would tell
        warnings.append(f"with {plan.implanted} fiducials a displaced one cannot be detected")
    return findings, warnings


def _check_fiducials(plan: Plan, points_mm: Array) -> CheckResult:
    """Check the number and layout of the fiducials (n, 3) in the CT against the plan.

    The x-shaped frame must be found; further spheres are reported.
    """
    if plan.fiducials is FiducialKind.XFRAME:
        return _check_frame(points_mm)
    if len(points_mm) == plan.implanted:
        if plan.template_mm is None or shows_template(plan.template_mm, points_mm):
            is_matched = not plan.fiducials.has_skin  # else landmarks tell the spheres apart
            return [], warn_of_ambiguity(points_mm) if is_matched else []
        return [NOT_THE_TEMPLATE("the fiducials in the CT do not match the plan's template")], []
    words = "the CT shows a different number of fiducials"
    return [WrongMarkerCount(words, expected=str(plan.implanted), got=str(len(points_mm)))], []


def _check_frame(points_mm: Array) -> CheckResult:
    try:
        others = find_layout(SPHERE_CENTRES_MM, points_mm).others
    except LayoutNotFound as missing:
        words = "the CT does not show the x-shaped frame"
        return [NOT_THE_FRAME(words, expected=missing.expected, got=missing.got)], []
    shown = ", ".join(str(one + 1) for one in others)
    return [], [f"spheres that do not belong to the x-shaped frame are ignored: {shown}"] if others else []


def _check_arm(
    check: PlanCheck,
    trajectories: tuple[Trajectory, ...],
    fiducials_mm: ArrayLike | None,
    arm: ArmSetting,
    sight: StereoSight | None,
) -> PlanCheck:
    """Add the path check of the arm: findings, or turns, a remark on looks and, with a scene, motions."""
    from procedures.planning.free_angle import (
        TurnedPaths,
        advice,
        choose_free_angles,
        find_alternatives,
        find_unreached,
    )
    from procedures.planning.learning_looks import choose_learning_looks
    from procedures.planning.motions import preview_motions
    from procedures.planning.paths import check_axes
    from procedures.planning.target_error import choose_best_strategies
    from procedures.planning.visits import Axes

    fiducials = np.asarray([] if fiducials_mm is None else fiducials_mm, dtype=float).reshape(-1, 3)
    if sight is None:
        axes = Axes.of(arm, trajectories, fiducials)
        own = dict.fromkeys((one.identifier for one in axes.distinct), 0.0)
        turned = TurnedPaths(check_axes(arm, axes, fiducials), axes, own)
    else:
        arm = choose_best_strategies(arm, trajectories, fiducials, sight)
        turned = choose_free_angles(arm, trajectories, fiducials, sight)
        turned = choose_learning_looks(arm, turned, fiducials, sight)
    if not turned.check.passed:
        alternatives: dict[str, tuple[Strategy, ...]] = {}
        if sight is not None and len(fiducials):
            unreached = find_unreached(turned.check, trajectories)
            failed = [one for one in trajectories if one.identifier in unreached]
            alternatives = {one.identifier: find_alternatives(arm, one, fiducials, sight) for one in failed}
        action, unmet = advice(alternatives), turned.check.unmet
        findings = (NotReachable(f"{one.pose}: {one.reason}", action=action) for one in unmet)
        return replace(check, findings=tuple(findings), unmet=unmet)
    motions: tuple[PreviewedMotion, ...] = ()
    if arm.scene is not None:
        motions = preview_motions(arm, arm.scene, turned.check, turned.axes.targeted)
    return replace(
        check,
        warnings=(turned.remark,) if turned.remark else (),
        motions=motions,
        turns_rad=tuple(turned.turns_rad.items()),
        paths=turned.check,
    )


def _warn_close_at_start(motions: Sequence[PreviewedMotion]) -> list[str]:
    """Warn of bodies closer than the margin at the start of a motion."""
    warnings_by_pair: dict[tuple[str, str], str] = {}
    for one in motions:
        closest = one.preview.closest
        if closest is not None and closest.distance_mm < one.motion.around.margin_mm - WITHIN_ROUNDING_MM:
            words = (
                f"the {closest.first} is {closest.distance_mm:.1f} mm from the {closest.second} at "
                f"{one.motion.start} already: change the position of the head or home"
            )
            warnings_by_pair.setdefault((closest.first, closest.second), words)
    return list(warnings_by_pair.values())


def _first_difference(plan: Plan, volume: Volume) -> str:
    """Say where two series UIDs of equal length differ by a digit or two, as mistyped ones do."""
    planned, found = plan.series_instance_uid, volume.series_instance_uid
    pairs = enumerate(zip(planned, found, strict=False), start=1)
    places = [number for number, (one, other) in pairs if one != other]
    if len(planned) != len(found) or len(places) > MOST_MISTYPED:
        return ""
    return f", whose UID differs in character {' and '.join(map(str, places))} only: mistyped?"


def _check_tool(plan: Plan) -> list[RonnaError]:
    if plan.tool in KNOWN_TOOLS:
        return []
    known = " or ".join(map(repr, KNOWN_TOOLS))
    return [UnknownTool("`tool` of the plan is unknown", expected=known, got=repr(plan.tool))]


def _check_instrument(plan: Plan, bore: GuideBore) -> list[RonnaError]:
    """Find trajectories whose depth stop does not fit on the instrument."""
    return [
        STOP_BEYOND_INSTRUMENT(
            f"trajectory {one.id}: the depth stop would be beyond the instrument's end",
            limit=f"{plan.instrument_length_mm:g} mm",
            got=f"{format_against_limit(stop_mm, plan.instrument_length_mm, 1)} mm",
        )
        for one, stop_mm in find_stops_beyond_end(plan, bore)
    ]


def _find_points_outside(plan: Plan, volume: Volume) -> list[RonnaError]:
    """Find entries and targets outside the CT, up to the outer voxel faces."""
    ends = zip("LPS", *volume.geometry.ends_mm, strict=True)
    extent = "; ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in ends)
    return [
        OUTSIDE_FIELD(
            f"the {name} of trajectory {one.id} at ({', '.join(f'{value:.1f}' for value in point)}) mm is "
            "outside the CT",
            expected=f"{extent} mm",
        )
        for one in plan.trajectories
        for name, point in (("entry", one.entry_mm), ("target", one.target_mm))
        if not volume.geometry.contains(point)
    ]


def least_side_difference_mm(triangle_mm: ArrayLike) -> float:
    """Return the smallest difference between two sides of a triangle of fiducials (3, 3), in mm."""
    points = np.asarray(triangle_mm, dtype=float)
    sides = np.sort([np.linalg.norm(points[a] - points[b]) for a, b in combinations(range(3), 2)])
    return float(np.diff(sides).min())


def shows_template(template_mm: ArrayLike, fiducials_mm: ArrayLike) -> bool:
    """Return whether fiducials (n, 3) contain a template (k, 3) in exactly one way, both in mm."""
    found = match_template(template_mm, fiducials_mm, IMPLANTED_SIGMA_MM, CT_SIGMA_MM)
    return found.status is MatchStatus.UNIQUE


def warn_of_ambiguity(fiducials_mm: Array) -> list[str]:
    """Return warnings about an ambiguous layout of fiducials (n, 3), in mm."""
    if len(fiducials_mm) == 3:
        smallest = least_side_difference_mm(fiducials_mm)
        if smallest >= LEAST_SIDE_DIFFERENCE_MM:
            return []
        return [
            f"two sides of the fiducial triangle differ by {smallest:.1f} mm (at least "
            f"{LEAST_SIDE_DIFFERENCE_MM:g} mm are needed to tell them apart)"
        ]
    self_match = match(fiducials_mm, fiducials_mm, sigma_image_mm=0.0, sigma_physical_mm=ROOM_SIGMA_MM)
    if self_match.status is not MatchStatus.AMBIGUOUS or self_match.runner_up is None:
        return []
    swaps = [f"{i + 1} for {j + 1}" for i, j in self_match.runner_up.pairs.tolist() if i != j]
    return [f"the fiducials look alike from another side: {', '.join(swaps)} could be mistaken"]
