"""Which sphere of the CT is which sphere in the room."""

from __future__ import annotations

import numpy as np

from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.registration import match
from procedures.registration.correspondence import MatchStatus
from procedures.registration.verification import verify_two_way
from procedures.steps.payloads import points_from, pose_payload
from ronna_hw.frames import Frame, Transform

SIGMA_CT_MM = 0.10  # per axis: what the localizer promises on a poor series, with reserve
SIGMA_TRACKER_MM = 0.35  # per axis: 0.25 mm rms of the volume, twice, for spheres and frame


def run(context: StepContext) -> Outcome:
    """Match; anything but a unique answer stops here with its reason."""
    localization = context.case.get("fiducial_localization")
    room = context.case.get("global_localization")
    plan = context.case.get("plan_check")
    image = points_from([marker["centre_mm"] for marker in localization.payload["markers"]])
    physical = points_from(room.payload["points_robot_mm"])
    answer = match(
        image,
        physical,
        sigma_image_mm=SIGMA_CT_MM,
        sigma_physical_mm=SIGMA_TRACKER_MM,
        expected=int(plan.payload["implanted"]),
    )
    transform = answer.require_unique()
    pairs = np.asarray(answer.pairs)
    disagreement = {
        index: float(marker["agreement_mm"]) for index, marker in enumerate(localization.payload["markers"])
    }
    table = verify_two_way(image, physical, pairs, transform, ct_disagreement_mm=disagreement)
    residuals = np.linalg.norm(physical[pairs[:, 1]] - transform.apply(image[pairs[:, 0]]), axis=1)
    return Outcome(
        payload={
            "status": MatchStatus(answer.status).value,
            "pairs": pairs.tolist(),
            "robot_from_ct": pose_payload(Transform(Frame.ROBOT, Frame.CT, transform)),
            "residuals_mm": residuals.tolist(),
            "margin_nats": answer.margin_nats if np.isfinite(answer.margin_nats) else None,
            "two_way": table.as_payload(),
        },
        parents=(localization, room, plan),
        summary=f"{len(pairs)} pairs, largest residual {residuals.max():.2f} mm",
    )


STEP = StepSpec(
    "correspondence",
    "Match the spheres of CT and room",
    needs=("fiducial_localization", "global_localization", "plan_check"),
    run=run,
)
