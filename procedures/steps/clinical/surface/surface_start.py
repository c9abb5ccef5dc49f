"""Start of a registration on the skin: landmarks of the head that are touched with a pointer.

Nose and ears also tell which reading of the tracker is which sphere, if the head carries some: up to three
could not tell that by their distances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose
from procedures.registration.correspondence import MatchStatus
from procedures.registration.surface.errors import MIRRORED_HEAD
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.starts import pair_spheres
from procedures.registration.verification import verify_two_way
from procedures.steps.clinical.correspondence import READ_AGAIN, SurfaceStart, TouchedPoint, touch_head
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.surface.carried_head import find_carried, start_carried, tell_whole_scan
from procedures.steps.clinical.surface.landmark_reading import (
    BY_POINTER,
    guess_order,
    list_landmarks,
    place_head,
    prior_with_clamp,
    read_landmarks,
    require_fit,
    tell_fit,
)
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.frames import Transform
from ronna_hw.text import format_against_limit, format_count
from ronna_hw.vectors import vector3

# Of an entry from the middle of the head: its mirror image is then 30 mm away.
# Safety against a mirrored CT. Source: three times what a touched mark errs (U).
LEAST_ASIDE_MM = 15.0
# Of the touched mark from the entry of the plan.
# Safety against a mistyped reading, and another patient. Source: an entry is chosen anew near its mark (U).
READ_MM = 40.0

TOUCH_AGAIN = "Repeat the step and touch nose and ears again, left and right as the patient has them."


def run(context: StepContext) -> Outcome[SurfaceStart]:
    """Have the landmarks touched, and fit the head to them, unless its clamp carries a former registration.

    Raises SRF-006, PRO-007, REG-004, REG-013.
    """
    context.result(ImportedCt)
    room, plan = context.result(GlobalLocalization), context.result(CheckedPlan)
    if (carried := find_carried(context)) is not None:
        return start_carried(carried)
    tell_whole_scan(context)
    in_ct_mm, touched_mm = read_landmarks(context, BY_POINTER)
    localized, prior = context.result(SkinInCt), prior_with_clamp(context)
    start, off_mm = place_head(in_ct_mm, touched_mm, prior, BY_POINTER)
    paired = pair_spheres(start, in_ct_mm, touched_mm, localized.centres_mm, room.points_mm)
    start = replace(start, robot_from_ct=paired.robot_from_ct)
    pose = start.robot_from_ct
    if paired.pairs:
        off_mm = require_fit(in_ct_mm, touched_mm, pose, prior, BY_POINTER, len(paired.pairs))
    guess = partial(guess_order, in_ct_mm, touched_mm, prior, BY_POINTER)
    site = touch_site(context, plan, pose, HeadAxes.of(skin_of(context)), guess)
    return Outcome(
        SurfaceStart(
            status=MatchStatus.UNIQUE,
            pairs=paired.pairs,
            robot_from_ct=FramedPose.of(pose),
            residuals_mm=paired.residuals_mm,
            margin_nats=None,
            two_way=verify_two_way(
                localized.centres_mm,
                room.points_mm,
                paired.pairs,
                pose,
                ct_disagreement_mm=localized.disagreement_mm,
            ),
            landmarks=list_landmarks(in_ct_mm, touched_mm, off_mm),
            turn_sd_rad=start.turn_rad,
            place_sd_mm=start.place_mm,
            site=site,
        ),
        summary=tell_fit(off_mm)
        + (f"; {format_count(len(paired.pairs), 'sphere')} paired" if paired.pairs else "")
        + tell_site(site),
    )


def tell_site(site: TouchedPoint | None) -> str:
    """Say where the touched mark is, as the end of a summary."""
    return "" if site is None else f"; the mark of {site.landmark} is {site.off_mm:.0f} mm from its entry"


def touch_site(
    context: StepContext,
    plan: CheckedPlan,
    robot_from_ct: Transform,
    axes: HeadAxes,
    guess_order: Callable[[Callable[[Transform], bool]], str] = lambda _explains: "",
) -> TouchedPoint | None:
    """Have the mark of the entry furthest aside touched. Raises SRF-006 if it is on the other side.

    `guess_order` names landmarks that were exchanged, if that explains the mark.

    Returns None if every entry is near the middle, where a mark does not tell left from right.
    """
    middle_mm = float(axes.middle_mm[0])
    aside = max(plan.plan.trajectories, key=lambda one: abs(one.entry_mm[0] - middle_mm))
    entry_mm = np.array(aside.entry_mm)
    if abs(entry_mm[0] - middle_mm) < LEAST_ASIDE_MM:
        return None
    order = f"touch the mark of {aside.id} on the patient's skin, made without this plan, with the pointer,"
    touched_mm = np.array(touch_head(context, order, site_of=aside.id))
    mirrored_mm = np.array([2.0 * middle_mm - entry_mm[0], *entry_mm[1:]])
    away_mm, away_mirrored_mm = (
        float(np.linalg.norm(touched_mm - robot_from_ct.apply(one))) for one in (entry_mm, mirrored_mm)
    )
    exchanged = ""
    if away_mm > min(READ_MM, away_mirrored_mm):
        exchanged = guess_order(
            lambda pose: float(np.linalg.norm(touched_mm - pose.apply(entry_mm))) <= READ_MM
        )
    if away_mirrored_mm < away_mm:
        raise MIRRORED_HEAD(
            f"the mark of {aside.id} is on the other side of the patient than its entry in the CT{exchanged}",
            expected=f"within {READ_MM:g} mm of the entry",
            got=f"{away_mm:.0f} mm from the entry, {away_mirrored_mm:.0f} mm from its mirror image",
            action=f"{TOUCH_AGAIN} {MIRRORED_HEAD.action}" if exchanged else None,
        )
    if away_mm > READ_MM:
        raise GateFailed(
            f"the mark of {aside.id} is not near its entry in the CT{exchanged}",
            limit=f"{READ_MM:g} mm",
            got=f"{format_against_limit(away_mm, READ_MM, 0)} mm",
            action=READ_AGAIN,
        )
    return TouchedPoint(
        landmark=aside.id, in_ct_mm=vector3(entry_mm), touched_mm=vector3(touched_mm), off_mm=away_mm
    )


STEP = StepSpec(
    SurfaceStart,
    "Place the head by landmarks",
    Phase.PREPARATION,
    run,
    reads=(ImportedCt, SkinInCt, GlobalLocalization, CheckedPlan),
    preconditions=needs_guide_unmounted,
)
