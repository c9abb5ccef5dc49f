"""From the identified arm to the records of the theatre file: deviations, head and tip, dated."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import numpy as np

from procedures.calibration.arm.error_model import ArmModel
from procedures.calibration.arm.identification import ArmFit, identify
from procedures.calibration.arm.looks import ArmLooks, arrays_of
from procedures.calibration.arm.validation import ArmValidation, validate
from procedures.calibration.head_model import pose_record
from procedures.calibration.record import LIFE, moved_tip, new_identifier
from ronna_hw.arm.catalogue import kinematics_named
from ronna_hw.calibration import ArmCalibration, StereoHeadCalibration, ToolTipCalibration
from ronna_hw.frames import Frame

MADE_BY = "ronna-arm calibrate"
DIGITS = 5  # of the covariance: large errors cancel to some hundredths of them


@dataclass(frozen=True)
class ArmResult:
    """The new records and their quality; `tool_shift_mm` is how far the head's tool centre moved.

    Head and tip keep their dates: where the head is on the flange was measured, cameras and tip were not.
    """

    fit: ArmFit
    validation: ArmValidation
    arm: ArmCalibration
    stereo_head: StereoHeadCalibration
    tool_tip: ToolTipCalibration | None
    tool_shift_mm: float


def calibrate_arm(observed: ArmLooks, *, life: timedelta = LIFE) -> ArmResult:
    """Dated records from measurements. Raises CAL-002 to CAL-004, CAL-011."""
    head = observed.stereo_head
    before = head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    identified = {one.sphere for one in observed.looks if not one.validation}
    # A sphere that was only validated has no fitted position to compare with.
    usable = [one for one in observed.looks if one.sphere in identified]
    looks = arrays_of(usable)
    kept = np.array([one.validation for one in usable], dtype=bool)
    fit = identify(ArmModel(kinematics_named(observed.arm), before), looks.only(~kept))
    validation = validate(fit, looks.only(kept))
    after = fit.flange_from_tool
    tip = None if observed.tool_tip is None else moved_tip(observed.tool_tip, before, after)
    return ArmResult(
        fit=fit,
        validation=validation,
        arm=ArmCalibration(
            identifier=new_identifier("arm", observed.created),
            stated_error_mm=validation.model_mm,
            arm=observed.arm,
            serial=observed.arm_serial or None,
            stereo_head_mm=pose_record(after).translation_mm,
            tool_tip_mm=None if tip is None else tip.flange_from_tool.translation_mm,
            scatter_mm=fit.scatter_mm,
            **fit.deviations.as_plain(),
            remaining=tuple(
                tuple(float(f"{value:.{DIGITS}g}") for value in row[: number + 1].tolist())
                for number, row in enumerate(fit.remaining)
            ),
            created=observed.created,
            expires=observed.created + life,
            made_by=MADE_BY,
        ),
        stereo_head=head.model_copy(
            update={
                "identifier": new_identifier("stereo-head", observed.created),
                "flange_from_tool": pose_record(after),
                "made_by": MADE_BY,  # by another method: not compared with one of the head alone
            }
        ),
        tool_tip=tip,
        tool_shift_mm=float(np.linalg.norm(after.translation_mm - before.translation_mm)),
    )
