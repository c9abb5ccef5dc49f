"""The evidence for accepting a registration, as tables with the question: the error budget, and both ways."""

from __future__ import annotations

from typing import TYPE_CHECKING

from procedures.operator.question import Evidence
from procedures.registration import TwoWayTable

if TYPE_CHECKING:
    from procedures.steps.clinical.registration import Prediction

NOTHING = "-"
# Rms at the spheres that remains after a rigid fit, as measured in docs/reference/scanner-faults.md. No scan
# shows these by itself.
NOT_PREDICTED = (
    "what is common to a scan (scale, table feed, motion, hidden tilt): 0.02 mm at the spheres for 0.1 % of "
    "table feed, 0.09 mm for a motion by 0.3 mm, 0.15 mm for a tilt of 0.5 deg"
)


def budget_table(predicted: Prediction) -> Evidence:
    """What the predicted error is made of, largest first, and what it leaves out."""
    shares = sorted(predicted.budget, key=lambda share: -share.rms_mm)
    return Evidence(
        title=f"Predicted error at {predicted.target}",
        head=("source", "mm rms"),
        rows=(
            *((share.source, f"{share.rms_mm:.3f}") for share in shares),
            ("total", f"{predicted.rms_mm:.3f}"),
            (f"not included: {predicted.excluded}", NOTHING),
        ),
    )


def two_way_table(table: TwoWayTable) -> Evidence:
    """Every sphere of the CT and what the room says about it; distances in mm."""
    return Evidence(
        title="CT to room and room to CT"
        + ("" if table.agrees_both_ways else ": the two directions do NOT agree")
        + "".join(f"; sphere {one + 1} is not confirmed" for one in table.unmatched_ct)
        + (f"; {len(table.unmatched_room)} readings match no sphere" if table.unmatched_room else ""),
        head=(
            "sphere",
            "CT estimates differ mm",
            "from tracker mm",
            "from stereo head mm",
            "when fitted without it mm",
            "partner is nearest",
        ),
        rows=tuple(
            (
                str(row.fiducial + 1),
                _mm(row.ct_disagreement_mm),
                _mm(row.tracker_residual_mm),
                _mm(row.stereo_residual_mm),
                _mm(row.leave_one_out_mm),
                {True: "yes", False: "NO", None: NOTHING}[row.partner_is_nearest],
            )
            for row in table.ct_to_room
        ),
    )


def _mm(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"
