"""Register CT and robot for one trajectory, and say what error to expect at its target.

The residual of the fit is never shown as accuracy; the operator accepts the predicted target error.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.engine.errors import GateFailed
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.registration import (
    Registration,
    RoomPoint,
    VerificationTable,
    register,
    verify_two_way,
)
from procedures.steps.payloads import points_from, pose_from, pose_payload
from procedures.steps.plan_check import trajectory_of
from procedures.steps.registration_gate import arm_covariance_mm2, moved_spheres, residual_gate
from ronna_hw.frames import Frame

Array = NDArray[np.float64]

LIMIT_OVER_RMS = 1.61  # 95 % radius of an isotropic 3-D normal error over its rms: sqrt(chi2_95(3) / 3)


class Prediction(NamedTuple):
    """Error to expect at the tip of the guide: rms, and the radius that holds it with `confidence`."""

    rms_mm: float
    limit_mm: float
    confidence: float
    formula: str


def run(context: StepContext) -> Outcome:
    """Fit with the covariances of CT, stereo head and arm; gate the residual; predict; have it accepted."""
    localization = context.case.get("fiducial_localization")
    fine = context.result("relocalization")
    correspondence = context.case.get("correspondence")
    trajectory = trajectory_of(context)
    markers = localization.payload["markers"]
    fiducials = [int(index) for index in fine.payload["fiducials"]]
    image = points_from([markers[index]["centre_mm"] for index in fiducials])
    physical = points_from(fine.payload["points_robot_mm"])
    coarse = pose_from(correspondence.payload["robot_from_ct"])
    ct = np.array([markers[index]["covariance_mm2"] for index in fiducials])
    stereo = np.array(fine.payload["covariances_mm2"])
    arm_mm = context.theatre.procedure.arm_error_mm
    rotation = coarse.rotation_matrix
    measured = rotation @ ct @ rotation.T + stereo
    fit = register(image, physical, covariance_mm2=measured + arm_covariance_mm2(arm_mm))
    fit.require_sound()
    gate = residual_gate(image, physical, measured, arm_mm)
    if not gate.passed:
        raise GateFailed(
            f"the fit does not agree with its own error budget at {context.key.trajectory}",
            limit=f"{gate.limit_mm:.3f} mm",
            got=f"{gate.fre_mm:.3f} mm",
            action=_advice([fiducials[one] for one in moved_spheres(image, physical, measured, arm_mm)]),
        )
    predicted = predict_tip_error(context, fit, trajectory.target_mm)
    if predicted.rms_mm > trajectory.margin_mm:
        raise GateFailed(
            f"the predicted error at {trajectory.id} exceeds the plan's margin",
            limit=f"{trajectory.margin_mm:g} mm",
            got=f"{predicted.rms_mm:.2f} mm",
        )
    context.confirm(
        f"accept the registration for {trajectory.id}",
        f"predicted target error {predicted.rms_mm:.2f} mm rms, "
        f"{predicted.limit_mm:.2f} mm at {predicted.confidence:.0%}",
    )
    return Outcome(
        payload={
            **_fit_payload(fit),
            "predicted_tre_mm": predicted.rms_mm,
            "predicted_tre_limit_mm": predicted.limit_mm,
            "confidence": predicted.confidence,
            "formula": predicted.formula,
            "two_way": _two_way(context, fit).as_payload(),
        },
        parents=(localization, fine, correspondence),
        summary=f"predicted target error {predicted.rms_mm:.2f} mm rms",
    )


def predict_tip_error(context: StepContext, fit: Registration, target_mm: ArrayLike) -> Prediction:
    """Error of the tip at a target (3,) mm in the CT: the fit's, the guide's, the stereo head's, the arm's.

    The fit does not know of guide, head and arm at the target: their stated errors come on top.
    """
    predicted = fit.predict_tre(np.reshape(np.asarray(target_mm, dtype=float), (1, 3)))
    tip_mm = context.calibrations.tool_tip.stated_error_mm
    head_mm = context.calibrations.stereo_head.stated_error_mm
    arm_mm2 = float(np.trace(arm_covariance_mm2(context.theatre.procedure.arm_error_mm)))
    rest_mm = math.sqrt(tip_mm**2 + head_mm**2 + arm_mm2)
    return Prediction(
        rms_mm=math.hypot(predicted.rms_mm[0], rest_mm),
        limit_mm=math.hypot(predicted.limit_mm[0], LIMIT_OVER_RMS * rest_mm),
        confidence=predicted.confidence,
        formula=f"{predicted.formula}; guide, stereo head and arm added in squares",
    )


def _advice(moved: list[int]) -> str:
    """What to do about spheres, named by their index in the CT, without one of which the others agree."""
    if not moved:
        return "More than one sphere has moved, or the error budget is wrong; localize again."
    which = " or ".join(str(one + 1) for one in moved)
    return f"Without sphere {which} the others agree: it has moved; localize again or leave it out."


def _two_way(context: StepContext, fit: Registration) -> VerificationTable:
    """Every sphere of the CT beside what tracker and stereo head measured of it, and the reverse."""
    markers = context.case.get("fiducial_localization").payload["markers"]
    correspondence = context.case.get("correspondence").payload
    fine = context.result("relocalization").payload
    return verify_two_way(
        points_from([marker["centre_mm"] for marker in markers]),
        points_from(context.case.get("global_localization").payload["points_robot_mm"]),
        correspondence["pairs"],
        pose_from(correspondence["robot_from_ct"]).rigid,
        fine=fit,
        stereo=[
            RoomPoint(int(index), _three(point))
            for index, point in zip(fine["fiducials"], points_from(fine["points_robot_mm"]), strict=True)
        ],
        ct_disagreement_mm={index: float(marker["agreement_mm"]) for index, marker in enumerate(markers)},
    )


def _fit_payload(fit: Registration) -> dict[str, Any]:
    return {
        "robot_from_ct": pose_payload(fit.between(Frame.ROBOT, Frame.CT)),
        "pairs": fit.pairs,
        "fre_mm": float(fit.fre_mm),
        "residuals_mm": fit.residuals_mm.tolist(),
        "leave_one_out_mm": list(fit.leave_one_out_mm),
    }


def _three(point: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return (x, y, z)


STEP = StepSpec(
    "registration",
    "Register CT and robot",
    needs=("relocalization", "correspondence", "fiducial_localization", "plan_check"),
    run=run,
    per_trajectory=True,
)
