"""Which sphere of the CT is which sphere in the room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.step import Outcome, Phase, StepSpec
from procedures.registration import match
from procedures.registration.correspondence import Match, MatchStatus
from procedures.registration.verification import TwoWayTable, verify_two_way
from procedures.results.result import FramedPose, StepResult
from procedures.steps.branches import FEWEST_SPHERES, LEAVE_OUT, UNMATCHED_SPHERE
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.spheres.coarse_match import SIGMA_CT_MM, SIGMA_TRACKER_MM, coarse_match
from procedures.steps.clinical.spheres.left_out import LeftOutSphere
from procedures.steps.conditions import localizable
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]


class Correspondence(StepResult, kind="correspondence"):
    """Pairs of spheres, and the coarse registration that they imply."""

    status: MatchStatus = Field(description="UNIQUE: no other status permits motion.")
    pairs: tuple[tuple[int, int], ...] = Field(description="Index in the CT, index in the room.")
    robot_from_ct: FramedPose = Field(description="Coarse pose robot <- CT.")
    residuals_mm: tuple[float, ...] = Field(description="Of each pair.")
    margin_nats: float | None = Field(description="Log-likelihood over the runner-up; none if there is none.")
    two_way: TwoWayTable = Field(description="CT to room and room to CT.")
    left_out: tuple[LeftOutSphere, ...] = Field(
        default=(), description="Implanted spheres that are not where the others predict."
    )


def run(context: StepContext) -> Outcome[Correspondence]:
    """Match, by the template where the plan has one; anything but a unique answer stops with its reason.

    Where a sphere is not in its place, the others serve when the operator agrees.
    """
    localization = context.result(LocalizedFiducials)
    room = context.result(GlobalLocalization)
    plan = context.result(CheckedPlan)
    image, physical = localization.centres_mm, room.points_mm
    found, left_out = _agreed_rest(context, coarse_match(plan, image, physical), image, physical)
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
            reason=f"the tracker sees nothing within {nearest_mm[one]:.1f} mm of its position",
        )
        for one in rest.unmatched_image
    )
    names = " and ".join(str(one.fiducial + 1) for one in left_out)
    question = UNMATCHED_SPHERE.question(
        f"sphere {names} of the CT is missing, on the wrong screw, or has moved",
        "; ".join(f"{one.fiducial + 1}: {one.reason}" for one in left_out)
        + (f"; the other {len(rest.pairs)} match, odds against any other pairing e^{rest.margin_nats:.0f}"),
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
