"""Rough place of the head, as somebody measures it: where the stereo head may take its first looks.

Nose and ears are measured from the base of the arm by a tape, for a theatre without a pointer. That is good
enough to keep clear of the head, and to find its skin in a whole picture. It has no part in the registration.
"""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.steps.clinical.correspondence import MeasuredHead
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.surface.carried_head import find_carried, start_carried, tell_whole_scan
from procedures.steps.clinical.surface.landmark_reading import (
    LandmarkReading,
    list_landmarks,
    place_head,
    prior_with_clamp,
    read_landmarks,
    tell_fit,
)
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.wire.room_tasks import MEASURE

# Safety against a stereo head that is sent into the head. Source: a tape held from the base by hand (U).
MEASURED_SD_MM = 15.0  # per axis

MEASURE_AGAIN = (
    "Measure again, from the origin of the arm's base along its axes, x, y and z in mm with their signs: "
    "first the tip of the nose, then the patient's left ear, then the right ear. If it stays so, compare the "
    "patient's position, the frame on the clamp and the CT with the plan."
)
BY_TAPE = LandmarkReading(
    MEASURE,
    "measure with a tape, to 3 cm, where the {} reaches furthest,",
    MEASURED_SD_MM,
    MEASURE_AGAIN,
)


def run(context: StepContext) -> Outcome[MeasuredHead]:
    """Have the head measured, unless its clamp carries a former registration.

    Raises PRO-007, REG-004, REG-013.
    """
    for before in (ImportedCt, SkinInCt, GlobalLocalization, CheckedPlan):
        context.result(before)
    if (carried := find_carried(context)) is not None:
        there = start_carried(carried).result.model_dump() | {"carried": None}
        summary = "the clamp has carried a registration: nothing is measured"
        return Outcome(MeasuredHead.model_validate(there), summary=summary)
    tell_whole_scan(context)
    in_ct_mm, measured_mm = read_landmarks(context, BY_TAPE)
    start, off_mm = place_head(in_ct_mm, measured_mm, prior_with_clamp(context), BY_TAPE)
    return Outcome(
        MeasuredHead.without_spheres(
            start.robot_from_ct,
            landmarks=list_landmarks(in_ct_mm, measured_mm, off_mm),
            turn_sd_rad=start.turn_rad,
            place_sd_mm=start.place_mm,
        ),
        summary=tell_fit(off_mm),
    )


STEP = StepSpec(
    MeasuredHead,
    "Measure where the head is",
    Phase.PREPARATION,
    run,
    reads=(ImportedCt, SkinInCt, GlobalLocalization, CheckedPlan),
    preconditions=needs_guide_unmounted,
)
