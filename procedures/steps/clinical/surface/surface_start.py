"""Start of a registration on the skin: landmarks of the head that are touched with a pointer.

Nose and ears are where the head reaches furthest to the front and to either side, so that a person finds
them on the patient and the computer in the CT, without a mark on either. They also tell which reading of the
tracker is which sphere, if the head carries some: up to three could not tell that by their distances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import chdtri

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.head_landmarks import find_landmark
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose
from procedures.registration.correspondence import MatchStatus
from procedures.registration.errors import HeadElsewhere
from procedures.registration.room_prior import LANDMARKS, RoomPrior
from procedures.registration.surface.errors import MIRRORED_HEAD
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.starts import LANDMARK_SD_MM, Start, pair_spheres
from procedures.registration.verification import verify_two_way
from procedures.steps.clinical.coarse_match import room_prior
from procedures.steps.clinical.correspondence import READ_AGAIN, SurfaceStart, TouchedPoint, touch_head
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.surface.carried_head import find_carried, start_carried
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform
from ronna_hw.text import format_against_limit, format_count
from ronna_hw.vectors import vector3
from ronna_hw.wire.room_tasks import TOUCH

TOUCHED = ("tip of the nose", "left ear", "right ear")
UNITS = {1: "cm", 3: "m"}  # by the power of ten that they are larger than mm
# Of an entry from the middle of the head: its mirror image is then 30 mm away.
# Safety against a mirrored CT. Source: three times what a touched mark errs (U).
LEAST_ASIDE_MM = 15.0
# Share of true readings that is taken for mistyped ones; the places are touched once more then.
# Safety against a mistyped reading, and against another patient. Source: 7.8 mm rms of three landmarks that
# err as above (U); in a trial, true readings had 1.4 to 2.1 mm, and a wrong sign at the nose 9.2 mm.
READ_AGAIN_SHARE = 0.01
# Of the touched mark from the entry of the plan.
# Safety against a mistyped reading, and another patient. Source: an entry is chosen anew near its mark (U).
READ_MM = 40.0


@dataclass(frozen=True)
class LandmarkReading:
    """How a person reads a landmark: the task, its order for a landmark, and the error per axis."""

    task: str
    order: str
    deviation_mm: float


BY_POINTER = LandmarkReading(
    TOUCH, "touch the {} with the pointer, where it reaches furthest,", LANDMARK_SD_MM
)


def run(context: StepContext) -> Outcome[SurfaceStart]:
    """Have the landmarks touched, and fit the head to them, unless its clamp carries a former registration.

    Raises SRF-006, PRO-007, REG-013.
    """
    context.result(ImportedCt)
    room, plan = context.result(GlobalLocalization), context.result(CheckedPlan)
    if (carried := find_carried(context)) is not None:
        return start_carried(carried)
    in_ct_mm, touched_mm = read_landmarks(context, BY_POINTER)
    start = Start.from_landmarks(in_ct_mm, touched_mm)
    localized = context.result(SkinInCt)
    prior = room_prior(plan, context.setting.settings, room.robot_from_tracker.transform)
    off_mm = require_fit(in_ct_mm, touched_mm, start.robot_from_ct, prior)
    paired = pair_spheres(start, in_ct_mm, touched_mm, localized.centres_mm, room.points_mm)
    start = replace(start, robot_from_ct=paired.robot_from_ct)
    pose = start.robot_from_ct
    if paired.pairs:
        off_mm = require_fit(in_ct_mm, touched_mm, pose, prior, len(paired.pairs))
    site = touch_site(context, plan, pose, HeadAxes.of(skin_of(context)))
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


def read_landmarks(context: StepContext, reading: LandmarkReading) -> tuple[Array, Array]:
    """Return the landmarks (3, 3) in the CT, and as a person reads them in the robot frame."""
    volume, skin_mm = volume_of(context), skin_of(context).points_mm
    in_ct_mm = np.array([find_landmark(volume, skin_mm, LANDMARKS[one]) for one in TOUCHED])
    read_mm = [
        touch_head(context, reading.order.format(one), LANDMARKS[one], task=reading.task) for one in TOUCHED
    ]
    return in_ct_mm, np.array(read_mm)


def list_landmarks(in_ct_mm: Array, read_mm: Array, off_mm: Array) -> tuple[TouchedPoint, ...]:
    """List the landmarks (3, 3) as they are recorded, with their distances (3,) from the fit."""
    return tuple(
        TouchedPoint(landmark=name, in_ct_mm=vector3(there), touched_mm=vector3(here), off_mm=off)
        for name, there, here, off in zip(TOUCHED, in_ct_mm, read_mm, off_mm.tolist(), strict=True)
    )


def tell_fit(off_mm: Array) -> str:
    """Say how well the landmarks fit."""
    return f"{len(TOUCHED)} landmarks, {_rms(off_mm):.1f} mm rms from their fit"


def tell_site(site: TouchedPoint | None) -> str:
    """Say where the touched mark is, as the end of a summary."""
    return "" if site is None else f"; the mark of {site.landmark} is {site.off_mm:.0f} mm from its entry"


def require_fit(
    in_ct_mm: Array,
    touched_mm: Array,
    pose: Transform,
    prior: RoomPrior,
    spheres: int = 0,
    deviation_mm: float = LANDMARK_SD_MM,
) -> Array:
    """Return how far the landmarks (3, 3), as read, are from where a pose robot <- CT has them.

    `spheres` were fitted beside them; `deviation_mm` is what a landmark errs per axis. Raises PRO-007 if they
    are further than that explains, and REG-013 if the head would be elsewhere than planned.
    """
    off_mm = np.asarray(np.linalg.norm(touched_mm - pose.apply(in_ct_mm), axis=1))
    if (limit_mm := _most_apart_mm(spheres, deviation_mm)) < _rms(off_mm):
        places = ", ".join(f"{one} {off:.0f} mm" for one, off in zip(TOUCHED, off_mm, strict=True))
        cause = _guess_cause(in_ct_mm, touched_mm, prior, deviation_mm)
        raise GateFailed(
            "nose and ears are not as far from each other as in the CT: "
            f"the {TOUCHED[int(off_mm.argmax())]} fits worst{cause}",
            limit=f"{limit_mm:.1f} mm rms",
            got=f"{format_against_limit(_rms(off_mm), limit_mm, 1)} mm; from their fit: {places}",
            action=READ_AGAIN,
        )
    if objection := _object_to(pose, prior):
        cause = _guess_cause(in_ct_mm, touched_mm, prior, deviation_mm)
        raise HeadElsewhere(f"by the landmarks {objection}{cause}", action=READ_AGAIN)
    return off_mm


def _most_apart_mm(spheres: int, deviation_mm: float) -> float:
    """Return the largest distance from their fit, rms, that landmarks have by their own error."""
    free = 3 * (len(TOUCHED) + spheres) - 6  # a pose takes six of the coordinates
    return deviation_mm * float(np.sqrt(chdtri(free, READ_AGAIN_SHARE) / len(TOUCHED)))


def _rms(off_mm: Array) -> float:
    return float(np.sqrt(np.mean(off_mm**2)))


def _object_to(pose: Transform, prior: RoomPrior) -> str:
    return prior.check_position(pose.rotation_matrix, np.asarray(pose.apply(prior.sight.centre_mm)))


def _guess_cause(in_ct_mm: Array, touched_mm: Array, prior: RoomPrior, deviation_mm: float) -> str:
    """Name the slip that would explain the readings, if one does."""
    larger = float(pdist(in_ct_mm).sum() / max(pdist(touched_mm).sum(), np.finfo(float).tiny))
    if (unit := UNITS.get(round(np.log10(larger)))) is not None:
        return f" (in {unit}?)"
    exchanged_mm = touched_mm[[0, 2, 1]]
    pose = Start.from_landmarks(in_ct_mm, exchanged_mm, deviation_mm).robot_from_ct
    off_mm = np.linalg.norm(exchanged_mm - pose.apply(in_ct_mm), axis=1)
    explains = _rms(off_mm) <= _most_apart_mm(0, deviation_mm) and not _object_to(pose, prior)
    return "; the ears may have been exchanged" if explains else ""


def touch_site(
    context: StepContext, plan: CheckedPlan, robot_from_ct: Transform, axes: HeadAxes
) -> TouchedPoint | None:
    """Have the mark of the entry furthest aside touched. Raises SRF-006 if it is on the other side.

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
    if away_mirrored_mm < away_mm:
        raise MIRRORED_HEAD(
            f"the mark of {aside.id} is on the other side of the patient than its entry in the CT",
            expected=f"within {READ_MM:g} mm of the entry",
            got=f"{away_mm:.0f} mm from the entry, {away_mirrored_mm:.0f} mm from its mirror image",
        )
    if away_mm > READ_MM:
        raise GateFailed(
            f"the mark of {aside.id} is not near its entry in the CT",
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
