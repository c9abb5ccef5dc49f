"""From readings to the tip's record: solved, validated on held-out readings, dated."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.special import fdtri

from procedures.calibration.errors import (
    BadObservations,
    DoesNotFit,
    FarFromRecord,
    ReadingImplausible,
)
from procedures.calibration.head_model import pose_record
from procedures.calibration.record import LIFE, new_identifier
from procedures.calibration.sufficiency import require_count
from procedures.calibration.tool_tip.looks import TipLooks, TipPairs, pairs_of
from procedures.calibration.tool_tip.tip import TipFit, fit_tip, tips_of
from ronna_hw.calibration import ToolTipCalibration
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import beyond, side_by_side

Array = NDArray[np.float64]

MADE_BY = "ronna-procedure calibrate tool-tip"
LEAST_VALIDATION = 2
ACCEPTED = 1e-4  # probability of rejecting a good calibration
MODEL_SHARE = 0.25  # of the predicted variance: resolution of the dials, arm errors that do not cancel
STAND_MM = 0.01  # between divot and ball centre, per axis: manufacturing tolerance of such stands
DIALS_TRAVEL_MM = 6.0
FAR_MM = 10.0  # no guide deviates this much from its drawing


@dataclass(frozen=True)
class TipResult:
    """The new record and its quality; `misses_mm` (m, 3) of held-out readings, tool frame."""

    fit: TipFit
    misses_mm: Array
    predicted_mm: float
    change_mm: float
    tool_tip: ToolTipCalibration


def calibrate_tip(observed: TipLooks, *, life: timedelta = LIFE) -> TipResult:
    """A dated record from readings. Raises CAL-002 to CAL-005, CAL-017 to CAL-019."""
    _require_plausible(observed)
    kept = set(observed.validation)
    fit = fit_tip(pairs_of(observed, [one for one in observed.readings if one.look not in kept]))
    misses, predicted_mm = _validated(
        fit, pairs_of(observed, [one for one in observed.readings if one.look in kept])
    )
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    before = observed.start.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    change_mm = float(np.linalg.norm(head.apply(fit.tip_mm) - before.translation_mm))
    if change_mm > FAR_MM:
        raise FarFromRecord(
            "the tip is not at its recorded position",
            limit=f"{FAR_MM:g} mm",
            got=f"{beyond(change_mm, FAR_MM, 1)} mm",
        )
    # A divot shows where the tip is, not where the guide points: direction and its error are kept.
    found = Transform(
        Frame.FLANGE,
        Frame.TOOL,
        RigidTransform.from_components(head.apply(fit.tip_mm), before.rigid.rotation),
    )
    gap_mm = max(fit.hidden_gap_mm, np.sqrt(3.0) * STAND_MM)
    stated_mm = float(np.sqrt(np.trace(fit.covariance_mm2) + gap_mm**2))
    return TipResult(
        fit=fit,
        misses_mm=misses,
        predicted_mm=predicted_mm,
        change_mm=change_mm,
        tool_tip=ToolTipCalibration(
            identifier=new_identifier("tool-tip", observed.created),
            created=observed.created,
            expires=observed.created + life,
            made_by=MADE_BY,
            stated_error_mm=stated_mm,
            tool_number=observed.start.tool_number,
            flange_from_tool=pose_record(found),
            stated_direction_error_rad=observed.start.stated_direction_error_rad,
        ),
    )


def require_plausible(dials_mm: tuple[float, float, float]) -> None:
    """Raise CAL-018 for readings that three dials in millimetres cannot show."""
    if not all(np.isfinite(dials_mm)) or max(map(abs, dials_mm)) > DIALS_TRAVEL_MM:
        raise ReadingImplausible(
            "the dials cannot show this",
            limit=f"each within ±{DIALS_TRAVEL_MM:g} mm",
            got=" ".join(f"{value:g}" for value in dials_mm),
        )


def _require_plausible(observed: TipLooks) -> None:
    numbers = [one.look for one in observed.readings]
    if len(set(numbers)) < len(numbers) or any(number >= len(observed.looks) for number in numbers):
        raise BadObservations(
            "each reading of the dials needs its own measurement", expected=f"0 to {len(observed.looks) - 1}"
        )
    for one in observed.readings:
        require_plausible(one.dials_mm)


def _validated(fit: TipFit, kept: TipPairs) -> tuple[Array, float]:
    """Misses (m, 3) of held-out readings, and their expected rms."""
    require_count(kept.count, LEAST_VALIDATION, "too few readings to validate the tip")
    misses = tips_of(kept) - fit.tip_mm
    variance = fit.scatter_mm**2 + float(np.trace(fit.covariance_mm2)) / 3.0
    rms_mm = float(np.sqrt(np.mean(np.sum(misses**2, axis=1))))
    # The scatter is estimated from few readings: the limit includes its own error (Fisher's F).
    ratio = float(fdtri(3 * kept.count, 3 * (len(fit.misses_mm) - 1), 1.0 - ACCEPTED))
    limit_mm = float(np.sqrt(3.0 * variance * ratio * (1.0 + MODEL_SHARE)))
    if rms_mm > limit_mm:
        rms, limit = side_by_side(rms_mm, limit_mm, 3)
        raise DoesNotFit(
            "the tip does not agree with the readings kept for validation",
            limit=f"{limit} mm rms",
            got=f"{rms} mm",
        )
    return misses, float(np.sqrt(3.0 * variance))
