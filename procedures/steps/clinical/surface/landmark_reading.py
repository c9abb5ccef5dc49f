"""Landmarks of the head as a person reads them: how they are read, fitted, and refused.

Nose and ears are where the head reaches furthest to the front and to either side, so that a person finds
them on the patient and the computer in the CT, without a mark on either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import chdtri

from procedures.engine.context import StepContext
from procedures.imaging.head_landmarks import find_landmark
from procedures.journal.errors import GateFailed
from procedures.registration.errors import DUPLICATE_POINTS, HeadElsewhere
from procedures.registration.room_prior import LANDMARKS, RoomPrior
from procedures.registration.surface.starts import LANDMARK_SD_MM, Start
from procedures.steps.clinical.coarse_match import room_prior
from procedures.steps.clinical.correspondence import READ_AGAIN, TouchedPoint, touch_head
from procedures.steps.clinical.ct_import import volume_of
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.frames import Transform
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import vector3
from ronna_hw.wire.room_tasks import TOUCH

TOUCHED = ("tip of the nose", "left ear", "right ear")
UNITS = {1: "cm", 3: "m"}  # by the power of ten that they are larger than mm
# Share of true readings that is taken for mistyped ones; the places are touched once more then.
# Safety against a mistyped reading, and against another patient. Source: 7.8 mm rms of three landmarks that
# err as above (U); in a trial, true readings had 1.4 to 2.1 mm, and a wrong sign at the nose 9.2 mm.
READ_AGAIN_SHARE = 0.01

OTHER_PATIENT = (
    "Otherwise this may be another patient than in the CT, or another CT than the patient's: compare the "
    "names of both."
)


@dataclass(frozen=True)
class LandmarkReading:
    """How a person reads a landmark: the task, its order for a landmark, the error per axis.

    `again` says what to do after readings that are refused.
    """

    task: str
    order: str
    deviation_mm: float
    again: str


BY_POINTER = LandmarkReading(
    TOUCH, "touch the {} with the pointer, where it reaches furthest,", LANDMARK_SD_MM, READ_AGAIN
)


def read_landmarks(context: StepContext, reading: LandmarkReading) -> tuple[Array, Array]:
    """Return the landmarks (3, 3) in the CT, and as a person reads them in the robot frame."""
    volume, skin_mm = volume_of(context), skin_of(context).points_mm
    in_ct_mm = np.array([find_landmark(volume, skin_mm, LANDMARKS[one]) for one in TOUCHED])
    read_mm = [
        touch_head(context, reading.order.format(one), LANDMARKS[one], task=reading.task) for one in TOUCHED
    ]
    return in_ct_mm, np.array(read_mm)


def prior_with_clamp(context: StepContext) -> RoomPrior:
    """Return the prior on the pose robot <- CT, with the frame on the head clamp as the tracker sees it."""
    room, plan = context.result(GlobalLocalization), context.result(CheckedPlan)
    robot_from_tracker = room.robot_from_tracker.transform
    prior = room_prior(plan, context.setting.settings, robot_from_tracker)
    if room.tracker_from_patient is None:
        return prior
    on_clamp = robot_from_tracker @ room.tracker_from_patient.transform
    return replace(prior, clamp_mm=on_clamp.translation_mm)


def place_head(
    in_ct_mm: Array, read_mm: Array, prior: RoomPrior, reading: LandmarkReading
) -> tuple[Start, Array]:
    """Fit the head to its landmarks (3, 3); return its start, and how far they are from their fit.

    Raises REG-004 for two that were read at one place, PRO-007 and REG-013 as `require_fit`.
    """
    try:
        start = Start.from_landmarks(in_ct_mm, read_mm, reading.deviation_mm)
    except RonnaError as problem:
        if not is_error(problem, DUPLICATE_POINTS):
            raise
        what = f"two of nose and ears were read at the same place{_guess_unit(in_ct_mm, read_mm)}"
        raise problem.reworded(what, limit=problem.limit, got=problem.got, action=reading.again) from problem
    return start, require_fit(in_ct_mm, read_mm, start.robot_from_ct, prior, reading)


def list_landmarks(in_ct_mm: Array, read_mm: Array, off_mm: Array) -> tuple[TouchedPoint, ...]:
    """List the landmarks (3, 3) as they are recorded, with their distances (3,) from the fit."""
    return tuple(
        TouchedPoint(landmark=name, in_ct_mm=vector3(there), touched_mm=vector3(here), off_mm=off)
        for name, there, here, off in zip(TOUCHED, in_ct_mm, read_mm, off_mm.tolist(), strict=True)
    )


def tell_fit(off_mm: Array) -> str:
    """Say how well the landmarks fit."""
    return f"{len(TOUCHED)} landmarks, {_rms(off_mm):.1f} mm rms from their fit"


def require_fit(
    in_ct_mm: Array,
    read_mm: Array,
    pose: Transform,
    prior: RoomPrior,
    reading: LandmarkReading,
    spheres: int = 0,
) -> Array:
    """Return how far the landmarks (3, 3), as read, are from where a pose robot <- CT has them.

    `spheres` were fitted beside them. Raises PRO-007 if they are further than a reading errs, and REG-013 if
    the head would be elsewhere than planned, or than its clamp.
    """
    off_mm = _off_mm(in_ct_mm, read_mm, pose)
    if (limit_mm := most_apart_mm(spheres, reading.deviation_mm)) < _rms(off_mm):
        places = ", ".join(f"{one} {off:.0f} mm" for one, off in zip(TOUCHED, off_mm, strict=True))
        cause = _guess_cause(in_ct_mm, read_mm, prior, reading)
        raise GateFailed(
            "nose and ears are not as far from each other as in the CT: "
            f"the {TOUCHED[int(off_mm.argmax())]} fits worst{cause}",
            limit=f"{limit_mm:.1f} mm rms",
            got=f"{format_against_limit(_rms(off_mm), limit_mm, 1)} mm; from their fit: {places}",
            action=reading.again if cause else f"{reading.again} {OTHER_PATIENT}",
        )
    if objection := _object_to(pose, prior):
        cause = _guess_cause(in_ct_mm, read_mm, prior, reading)
        raise HeadElsewhere(f"by the landmarks {objection}{cause}", action=reading.again)
    return off_mm


def _off_mm(in_ct_mm: Array, read_mm: Array, pose: Transform) -> Array:
    return np.asarray(np.linalg.norm(read_mm - pose.apply(in_ct_mm), axis=1))


def most_apart_mm(spheres: int, deviation_mm: float) -> float:
    """Return the largest distance from their fit, rms, that landmarks have by their own error."""
    free = 3 * (len(TOUCHED) + spheres) - 6  # a pose takes six of the coordinates
    return deviation_mm * float(np.sqrt(chdtri(free, READ_AGAIN_SHARE) / len(TOUCHED)))


def _rms(off_mm: Array) -> float:
    return float(np.sqrt(np.mean(off_mm**2)))


def _object_to(pose: Transform, prior: RoomPrior) -> str:
    return prior.check_position(pose.rotation_matrix, np.asarray(pose.apply(prior.sight.centre_mm)))


def _guess_cause(in_ct_mm: Array, read_mm: Array, prior: RoomPrior, reading: LandmarkReading) -> str:
    """Name the slip that would explain the readings, if one does: a unit, or the order that fits best."""
    return _guess_unit(in_ct_mm, read_mm) or guess_order(in_ct_mm, read_mm, prior, reading)


def guess_order(
    in_ct_mm: Array,
    read_mm: Array,
    prior: RoomPrior,
    reading: LandmarkReading,
    explains: Callable[[Transform], bool] = lambda _pose: True,
) -> str:
    """Name the landmarks that were exchanged, if that fits, and its pose robot <- CT `explains` the rest."""
    found: list[tuple[float, Sequence[int]]] = []
    for order in permutations(range(len(TOUCHED))):
        sorted_mm = read_mm[list(order)]
        pose = Start.from_landmarks(in_ct_mm, sorted_mm, reading.deviation_mm).robot_from_ct
        rms_mm = _rms(_off_mm(in_ct_mm, sorted_mm, pose))
        if (
            rms_mm <= most_apart_mm(0, reading.deviation_mm)
            and not _object_to(pose, prior)
            and explains(pose)
        ):
            found.append((rms_mm, order))
    return _tell_order(min(found)[1]) if found else ""


def _guess_unit(in_ct_mm: Array, read_mm: Array) -> str:
    """Name the unit of length that would explain how near each other the readings are, if one does."""
    larger = float(pdist(in_ct_mm).sum() / max(pdist(read_mm).sum(), np.finfo(float).tiny))
    unit = UNITS.get(round(np.log10(larger)))
    return "" if unit is None else f" (in {unit}?)"


def _tell_order(order: Sequence[int]) -> str:
    """Say which landmarks were exchanged, if each was read where `order` has it."""
    exchanged = [name for place, name in enumerate(TOUCHED) if order[place] != place]
    if exchanged == list(TOUCHED[1:]):
        return "; the ears may have been exchanged"
    if len(exchanged) == len(TOUCHED):
        read = [TOUCHED[order.index(place)] for place in range(len(TOUCHED))]
        return f"; they may have been read in another order: {', '.join(read)}"
    return f"; the {exchanged[0]} and the {exchanged[1]} may have been exchanged" if exchanged else ""
