"""Which sphere of the CT is which sphere in the room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.result import FramedPose, StepResult
from procedures.engine.step import Outcome, Phase, StepSpec
from procedures.planning.plan import FiducialKind
from procedures.registration import match, match_by_template
from procedures.registration.correspondence import Match, MatchStatus
from procedures.registration.verification import TwoWayTable, verify_two_way
from procedures.steps.branches import FEWEST_SPHERES, LEAVE_OUT, UNMATCHED_SPHERE
from procedures.steps.clinical.conditions import localizable
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.left_out_sphere import LeftOutSphere
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.frames import Frame, Transform
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM
from ronna_hw.x_frame import SPHERE_CENTRES_MM

Array = NDArray[np.float64]

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
    left_out: tuple[LeftOutSphere, ...] = Field(
        default=(), description="Implanted, and not where the others say."
    )


def run(context: StepContext) -> Outcome[Correspondence]:
    """Match, by the template where the plan has one; anything but a unique answer stops with its reason.

    Where a sphere is not in its place, the others serve when the operator agrees.
    """
    localization = context.result(LocalizedFiducials)
    room = context.result(GlobalLocalization)
    plan = context.result(CheckedPlan)
    image, physical = localization.centres_mm, room.points_mm
    found, left_out = _agreed_rest(context, _matched(plan, image, physical), image, physical)
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
            left_out=left_out,
        ),
        summary=f"{len(pairs)} pairs, largest residual {residuals.max():.2f} mm"
        + "".join(f"; without sphere {one.fiducial + 1}" for one in left_out),
    )


def _matched(plan: CheckedPlan, image: Array, physical: Array) -> Match:
    """By the frame or the template, or all that were implanted."""
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


def _agreed_rest(
    context: StepContext, found: Match, image: Array, physical: Array
) -> tuple[Match, tuple[LeftOutSphere, ...]]:
    """The match as it is; or of fewer spheres than were implanted, which is unique, when agreed to."""
    if found.status not in (MatchStatus.TOO_FEW, MatchStatus.INCONSISTENT):
        return found, ()
    rest = match(image, physical, sigma_image_mm=SIGMA_CT_MM, sigma_physical_mm=SIGMA_TRACKER_MM)
    if rest.transform is None or rest.status is not MatchStatus.UNIQUE or len(rest.pairs) < FEWEST_SPHERES:
        return found, ()
    places = rest.transform.apply(image)
    nearest_mm = np.linalg.norm(physical[None] - places[:, None], axis=2).min(axis=1)
    left_out = tuple(
        LeftOutSphere(
            fiducial=one,
            reason=f"the tracker sees nothing nearer to its place than {nearest_mm[one]:.1f} mm",
        )
        for one in rest.unmatched_image
    )
    names = " and ".join(str(one.fiducial + 1) for one in left_out)
    question = UNMATCHED_SPHERE.question(
        f"sphere {names} of the CT is missing, on a wrong screw, or has moved",
        "; ".join(f"{one.fiducial + 1}: {one.reason}" for one in left_out)
        + f"; the other {len(rest.pairs)} match, odds against any other pairing e^{rest.margin_nats:.0f}",
    )
    return (rest, left_out) if context.choose(question) == LEAVE_OUT else (found, ())


STEP = StepSpec(
    Correspondence,
    "Match the spheres of CT and room",
    Phase.PREPARATION,
    run,
    reads=(LocalizedFiducials, GlobalLocalization, CheckedPlan),
    preconditions=localizable,
)
