"""Matching of spheres in CT and room, using plan template and patient position as priors.

The thesis' matcher takes no template. What the case knows besides the distances (how many were implanted, how
the patient lies, what the tracker can see) refuses its pairing where it would refuse ours.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.engine.methods import CaseMethods, Matcher
from procedures.planning.plan_model import UP_LPS, FiducialKind
from procedures.registration import match, match_by_template
from procedures.registration.correspondence import Match, MatchStatus, PosePrior
from procedures.registration.room_prior import MIRROR, HeadSight, RoomPrior
from procedures.registration.template import TEMPLATE_SIGMA_MM
from procedures.registration.thesis_matching import match_as_thesis
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.arrays import Array
from ronna_hw.config import ProcedureSettings
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.frames import Transform
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM
from ronna_hw.x_frame import SPHERE_CENTRES_MM

SIGMA_CT_MM = 0.10  # per axis: the localizer's error on a poor series, with reserve; the thesis' have 0.097
SIGMA_TRACKER_MM = 0.35  # per axis: 0.25 mm rms of the volume, twice, for spheres and frame


def room_prior(plan: CheckedPlan, settings: ProcedureSettings, robot_from_tracker: Transform) -> RoomPrior:
    """Return the prior on the pose robot <- CT from patient position and the tracker's line of sight."""
    return RoomPrior(
        lying_up=np.array(UP_LPS[plan.plan.table_orientation.value[2:]]),
        recline_deg=settings.recline_deg,
        tolerance_deg=settings.head_turn_deg,
        sight=HeadSight(
            centre_mm=np.array(plan.head.centre_mm),
            semi_axes_mm=np.array(plan.head.semi_axes_mm),
            eyes_mm=robot_from_tracker.apply(SENSORS_MM),
        ),
    )


def mirror_images(image: Array, physical: Array, prior: RoomPrior) -> list[RigidTransform]:
    """Return the poses, visible to the tracker, at which the mirrored spheres (n, 3) would fit too.

    Always by our matcher, since the thesis' asks no such question.
    """
    found = match_by_distances(
        image * MIRROR, physical, prior.sight.mirrored(), CaseMethods(), expected=len(image)
    )
    if found.transform is None:
        return []
    rival = [found.runner_up.transform] if found.status is not MatchStatus.UNIQUE and found.runner_up else []
    return [found.transform, *rival]


def coarse_match(
    plan: CheckedPlan,
    localized: LocalizedFiducials,
    physical: Array,
    prior: PosePrior,
    methods: CaseMethods,
) -> Match:
    """Match spheres in CT and room (m, 3), mm, by the plan's template or else by distances.

    The match counts the spheres that are `shown`.
    """
    image, expected = localized.centres_mm[list(localized.shown)], localized.count_expected(plan.implanted)
    template_mm, sigma_mm = plan.plan.template_mm, IMPLANTED_SIGMA_MM
    if plan.plan.fiducials is FiducialKind.XFRAME:
        template_mm, sigma_mm = SPHERE_CENTRES_MM, TEMPLATE_SIGMA_MM
    is_thesis = methods.matcher is Matcher.THESIS
    if is_thesis or template_mm is None or expected != len(template_mm):
        return match_by_distances(image, physical, prior, methods, expected=expected)
    return match_by_template(
        template_mm,
        image,
        physical,
        sigma_image_mm=SIGMA_CT_MM,
        sigma_physical_mm=SIGMA_TRACKER_MM,
        sigma_template_mm=sigma_mm,
        prior=prior,
    )


def match_by_distances(
    image: Array, physical: Array, prior: PosePrior, methods: CaseMethods, expected: int | None = None
) -> Match:
    """Match by distances and prior alone, without a template."""
    if methods.matcher is Matcher.THESIS:
        return match_as_thesis(
            image,
            physical,
            e_mm=methods.e_mm,
            sigma_image_mm=SIGMA_CT_MM,
            sigma_physical_mm=SIGMA_TRACKER_MM,
            refused_share=methods.refused_share,
            expected=expected,
            prior=prior,
        )
    return match(
        image,
        physical,
        sigma_image_mm=SIGMA_CT_MM,
        sigma_physical_mm=SIGMA_TRACKER_MM,
        expected=expected,
        prior=prior,
    )
