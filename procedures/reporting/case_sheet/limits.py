"""Limits that a case keeps, with their units and what happens beyond each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from procedures.calibration.base_to_base import LARGEST_ERROR_MM
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.guards.default_guards import LARGEST_BAD_SHARE
from procedures.guards.guide_displacement import PUSHED_MM
from procedures.guards.head_frames import PATIENT_LIMIT_MM
from procedures.guards.head_sight import MOST_UNSEEN_S
from procedures.guards.stability import GUIDE_NOTICEABLE_MM, guide_noticeable_mm
from procedures.guards.tracker_guards import LATE_S
from procedures.operator.checkpoint import PATIENCE_S
from procedures.planning.plan_model import FiducialKind
from procedures.registration.surface.checks import SurfaceLimits
from procedures.registration.surface.spheres import MOVED_PROBABILITY
from procedures.steps.branches import FEWEST_SPHERES
from procedures.steps.clinical.at_target import POSITION_LIMIT_MM
from procedures.steps.clinical.cart_lock import LOCKED_LIMIT_MM
from procedures.steps.clinical.error_budget import GATE_CONFIDENCE
from procedures.steps.clinical.followed_move import MOST_FOLLOWED_RAD
from procedures.steps.clinical.global_localization import SPREAD_LIMIT_MM
from procedures.steps.clinical.room import MOST_FOLLOWED_MM
from procedures.steps.clinical.surface.carried_head import MOST_CARRIED_MM, MOST_CARRIED_RAD, MOST_SLIPPED_MM
from procedures.steps.clinical.surface.surface_start import READ_MM
from procedures.steps.clinical.tool_check import TILT_LIMIT_DEG
from procedures.steps.clinical.two_arms.assisted_insertion import LARGEST_GAP_MM
from procedures.steps.clinical.two_arms.over_guide import COAXIAL_MM, COAXIAL_RAD
from procedures.steps.clinical.two_arms.skull_opening import EARLY_MM, LATE_MM
from procedures.steps.clinical.work_progress import STOP_LIMIT_MM
from procedures.steps.conditions import LONGEST_S
from ronna_hw.arm.catalogue import ARMS
from ronna_hw.arm.clearance.arm_pair import APART_AT_GUIDE_MM, APART_MM
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.config import ProcedureSettings

S_PER_MIN = 60.0


class LimitRow(NamedTuple):
    """A limit as printed: its value with the unit, and what happens beyond it."""

    what: str
    value: str
    beyond: str


def limits_of_case(
    cell: CollisionConfig,
    settings: ProcedureSettings,
    arm: str,
    fiducials: FiducialKind = FiducialKind.FREE,
    *,
    dual: bool,
) -> tuple[LimitRow, ...]:
    """List the limits in the order in which a case meets them. `arm` is a model, empty if not known."""
    registering = _on_skin(settings, fiducials) if fiducials.has_skin else _by_spheres(settings)
    before, on_the_way = _before_motion(fiducials), _on_the_way(cell, fiducials)
    rows = (*before, *registering, *on_the_way, *_at_target(arm))
    return (*rows, *_with_two_arms(settings)) if dual else rows


def _before_motion(fiducials: FiducialKind) -> Iterator[LimitRow]:
    if fiducials is not FiducialKind.SURFACE:
        yield LimitRow("one sphere over the tracker's frames", _mm(SPREAD_LIMIT_MM, "rms"), "the step fails")
    yield LimitRow(
        "cart, leaned on from each side", _mm(LOCKED_LIMIT_MM), "the cart is not locked: the step fails"
    )


def _by_spheres(settings: ProcedureSettings) -> Iterator[LimitRow]:
    yield _sphere_by_stereo(settings)
    yield LimitRow(
        "spheres needed to leave one out",
        f"{FEWEST_SPHERES}",
        "with 3, none is left out, and a moved one cannot be found",
    )
    yield LimitRow(
        "residuals of the registration",
        f"{GATE_CONFIDENCE:.1%} of what the stated errors explain",
        "refused; if one sphere explains it, it may be left out",
    )
    yield _predicted()


def _on_skin(settings: ProcedureSettings, fiducials: FiducialKind) -> Iterator[LimitRow]:
    limits = SurfaceLimits()
    yield LimitRow(
        "the touched mark of an entry from the plan's", _mm(READ_MM), "the step fails: touch them again"
    )
    yield LimitRow("skin above the jaw that is scanned, at least", f"{limits.least_coverage:.0%}", "refused")
    yield LimitRow("hair and other bodies in the scan", f"{limits.most_hidden:.0%}", "refused")
    yield LimitRow(
        "scan from the skin of the CT", _mm(limits.largest_residual_mm, "robust"), "refused: another head"
    )
    yield LimitRow("scan with skin that has moved", f"{limits.most_changed:.0%}", "refused")
    if fiducials is FiducialKind.MIXED:
        yield _sphere_by_stereo(settings)
        yield LimitRow(
            "a sphere from where the skin and the other spheres have it",
            f"less likely than {MOVED_PROBABILITY:g} by the stated errors",
            "refused: its screw may have moved",
        )
    yield LimitRow("predicted limit of the error at a target", _mm(limits.largest_error_mm), "refused")
    yield _predicted()


def _sphere_by_stereo(settings: ProcedureSettings) -> LimitRow:
    return LimitRow(
        "a sphere by the stereo head from its place by the tracker",
        _mm(settings.coarse_fine_limit_mm),
        "the sphere is not taken",
    )


def _predicted() -> LimitRow:
    return LimitRow(
        "predicted error at a target, rms", "the accepted error of the plan", "asked: leave it out, or hold"
    )


def _on_the_way(cell: CollisionConfig, fiducials: FiducialKind) -> Iterator[LimitRow]:
    zone = cell.zone
    yield LimitRow("clearance along a planned path, at least", _mm(cell.margin_mm), "the path is refused")
    yield LimitRow("clearance of the moving arm, at least", _mm(cell.live_margin_mm), "the arm stops")
    yield LimitRow("corridor of the instrument about its axis", _mm(cell.corridor_mm, "radius"), "it stops")
    yield LimitRow(
        "speed of all that moves, near the head",
        f"{zone.near_speed_mm_s:g} mm/s up to {zone.near_mm:g} mm from it, rising to "
        f"{zone.far_speed_mm_s:g} mm/s at {zone.far_mm:g} mm",
        "motions are planned slower",
    )
    yield LimitRow(
        "head moved while the arm moves", _mm(PATIENT_LIMIT_MM, "rms"), "the arm stops; localize again"
    )
    if fiducials.has_skin:
        yield LimitRow(
            "move of the clamp after which a few looks at the skin are enough",
            f"{MOST_CARRIED_MM:g} mm and {math.degrees(MOST_CARRIED_RAD):g}°",
            "touch nose and ears, and scan the whole skin again",
        )
        yield LimitRow("slip of the head in its clamp by these looks", _mm(MOST_SLIPPED_MM), "the same")
    else:
        yield LimitRow(
            "move of the head that a registration may follow",
            f"{MOST_FOLLOWED_MM:g} mm and {math.degrees(MOST_FOLLOWED_RAD):g}°",
            "register again",
        )
    yield LimitRow(
        "head unseen near the guide", f"{MOST_UNSEEN_S:g} s", "suspended; asked: wait, go on or leave"
    )
    yield LimitRow("reply of the tracker, median", f"{LATE_S:g} s", "suspended until it is faster")
    yield LimitRow("late or lost cycles of the arm's link", f"{LARGEST_BAD_SHARE:.0%}", "suspended")
    yield LimitRow("a suspended case", f"{PATIENCE_S:g} s", "asked: wait or leave")


def _at_target(arm: str) -> Iterator[LimitRow]:
    noticeable = (
        f"{guide_noticeable_mm(arm):.3g} mm" if arm in ARMS else f"from {GUIDE_NOTICEABLE_MM:g} mm on"
    )
    yield LimitRow(
        "guide on the gauge, from its record", f"{noticeable}, {TILT_LIMIT_DEG:g}°", "asked: mount it again"
    )
    yield LimitRow("guide from where it was sent", _mm(POSITION_LIMIT_MM), "the step fails")
    yield LimitRow("guide pushed while someone works", _mm(PUSHED_MM), "suspended until it is let go")
    yield LimitRow(
        "depth stop from the computed one", _mm(STOP_LIMIT_MM), "set it again, three times at most"
    )
    yield LimitRow("age of a reading of stop or gauge", f"{LONGEST_S / S_PER_MIN:g} min", "it is read again")


def _with_two_arms(settings: ProcedureSettings) -> Iterator[LimitRow]:
    yield LimitRow("bases of both arms, error of meeting", _mm(LARGEST_ERROR_MM), "no arm meets the other")
    yield LimitRow(
        "distance between the arms, at least",
        f"{APART_MM:g} mm, {APART_AT_GUIDE_MM:g} mm at the guide",
        "both stop",
    )
    yield LimitRow(
        "instrument from the guide's axis, by the joints",
        f"{COAXIAL_MM:g} mm and {math.degrees(COAXIAL_RAD):g}°",
        "it is not led in",
    )
    yield LimitRow("the same, by the tracker with its bound", _mm(LARGEST_OFF_MM), "it is not led in")
    yield LimitRow(
        "force on the instrument", f"{settings.insertion_force_N:g} N", "it stops, if the arm senses force"
    )
    if settings.assistant_drills:
        yield LimitRow("force on the drill", f"{settings.drill_force_N:g} N", "its feed stops")
        yield LimitRow(
            "breakthrough from the inside of the skull by the CT",
            f"{EARLY_MM:g} mm before, {LATE_MM:g} mm behind",
            "asked",
        )
    yield LimitRow("gap between stop and guide", _mm(LARGEST_GAP_MM), "not at depth: asked")


def _mm(value_mm: float, kind: str = "") -> str:
    return f"{value_mm:g} mm {kind}".rstrip()
