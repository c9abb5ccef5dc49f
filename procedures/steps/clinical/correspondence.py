"""Which sphere of the CT is which sphere in the room."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.result import FramedPose, StepResult
from procedures.engine.step import Outcome, Phase, StepSpec
from procedures.registration import match, match_by_template
from procedures.registration.correspondence import MatchStatus
from procedures.registration.verification import TwoWayTable, verify_two_way
from procedures.steps.clinical.conditions import localizable
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.frames import Frame, Transform
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM

SIGMA_CT_MM = 0.10  # per axis: what the localizer promises on a poor series, with reserve
SIGMA_TRACKER_MM = 0.35  # per axis: 0.25 mm rms of the volume, twice, for spheres and frame


class Correspondence(StepResult, kind="correspondence"):
    """Pairs of spheres, and the coarse registration that they imply."""

    status: MatchStatus = Field(description="UNIQUE: nothing else may be used to move anything.")
    pairs: tuple[tuple[int, int], ...] = Field(description="Index in the CT, index in the room.")
    robot_from_ct: FramedPose = Field(description="Coarse pose robot <- CT.")
    residuals_mm: tuple[float, ...] = Field(description="Of each pair.")
    margin_nats: float | None = Field(description="Log-likelihood over the runner-up; none without one.")
    two_way: TwoWayTable = Field(description="CT to room and room to CT.")


def run(context: StepContext) -> Outcome[Correspondence]:
    """Match, by the template where the plan has one; anything but a unique answer stops with its reason."""
    localization = context.result(LocalizedFiducials)
    room = context.result(GlobalLocalization)
    plan = context.result(CheckedPlan)
    image, physical = localization.centres_mm, room.points_mm
    template_mm = plan.plan.template_mm
    if template_mm is not None and plan.implanted == len(template_mm):
        found = match_by_template(
            template_mm,
            image,
            physical,
            sigma_image_mm=SIGMA_CT_MM,
            sigma_physical_mm=SIGMA_TRACKER_MM,
            sigma_template_mm=IMPLANTED_SIGMA_MM,
        )
    else:
        found = match(
            image,
            physical,
            sigma_image_mm=SIGMA_CT_MM,
            sigma_physical_mm=SIGMA_TRACKER_MM,
            expected=plan.implanted,
        )
    transform = found.require_unique()
    pairs = np.asarray(found.pairs)
    table = verify_two_way(image, physical, pairs, transform, ct_disagreement_mm=localization.disagreement_mm)
    residuals = np.linalg.norm(physical[pairs[:, 1]] - transform.apply(image[pairs[:, 0]]), axis=1)
    return Outcome(
        Correspondence(
            status=MatchStatus(found.status),
            pairs=pairs.tolist(),
            robot_from_ct=FramedPose.of(Transform(Frame.ROBOT, Frame.CT, transform)),
            residuals_mm=residuals.tolist(),
            margin_nats=found.margin_nats if np.isfinite(found.margin_nats) else None,
            two_way=table,
        ),
        summary=f"{len(pairs)} pairs, largest residual {residuals.max():.2f} mm",
    )


STEP = StepSpec(
    Correspondence,
    "Match the spheres of CT and room",
    Phase.PREPARATION,
    run,
    reads=(LocalizedFiducials, GlobalLocalization, CheckedPlan),
    preconditions=localizable,
)
