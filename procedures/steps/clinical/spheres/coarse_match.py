"""Which sphere of the CT is which in the room, by what the plan says of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.planning.plan.model import FiducialKind
from procedures.registration import match, match_by_template
from procedures.registration.correspondence import Match
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM
from ronna_hw.x_frame import SPHERE_CENTRES_MM

Array = NDArray[np.float64]

SIGMA_CT_MM = 0.10  # per axis: what the localizer promises on a poor series, with reserve
SIGMA_TRACKER_MM = 0.35  # per axis: 0.25 mm rms of the volume, twice, for spheres and frame


def coarse_match(plan: CheckedPlan, image: Array, physical: Array) -> Match:
    """By the frame or the template, or all that were implanted.

    Spheres in the CT (n, 3) and in the room (m, 3), mm.
    """
    if plan.plan.fiducials is FiducialKind.XFRAME:
        return match_by_template(
            SPHERE_CENTRES_MM,
            image,
            physical,
            sigma_image_mm=SIGMA_CT_MM,
            sigma_physical_mm=SIGMA_TRACKER_MM,
        )
    template_mm = plan.plan.template_mm
    if template_mm is not None and plan.implanted == len(template_mm):
        return match_by_template(
            template_mm,
            image,
            physical,
            sigma_image_mm=SIGMA_CT_MM,
            sigma_physical_mm=SIGMA_TRACKER_MM,
            sigma_template_mm=IMPLANTED_SIGMA_MM,
        )
    return match(
        image,
        physical,
        sigma_image_mm=SIGMA_CT_MM,
        sigma_physical_mm=SIGMA_TRACKER_MM,
        expected=plan.implanted,
    )
