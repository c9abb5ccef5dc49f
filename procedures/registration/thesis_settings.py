"""Settings of the thesis' matcher: their ranges, and what they are unless told otherwise.

Free of numerics, since commands import this at start-up.
"""

from __future__ import annotations

from procedures.registration.errors import BadParameter

E_RANGE_MM = (1.0, 6.0)  # as tried in the thesis, 5.3.1
E_STEP_MM = 0.1
THESIS_TOLERANCES_MM = tuple(
    round(E_RANGE_MM[0] + E_STEP_MM * step, 1)
    for step in range(round((E_RANGE_MM[1] - E_RANGE_MM[0]) / E_STEP_MM) + 1)
)
# The smallest at which the thesis paired all its clinical readings (figures 14 and 15); it states no single
# value.
E_MM = 2.5
REFUSED_SHARE_RANGE = (1e-6, 0.5)
REFUSED_SHARE = 1e-3  # of the correct pairings; ours, as the thesis states no rule for its validation


def check_thesis_settings(e_mm: float, refused_share: float) -> None:
    """Raise REG-007 unless e and the refused share are within their ranges."""
    if not E_RANGE_MM[0] <= e_mm <= E_RANGE_MM[1]:
        raise BadParameter(
            "e of the thesis' matcher is out of range",
            limit=f"{E_RANGE_MM[0]:g} to {E_RANGE_MM[1]:g} mm",
            got=f"{e_mm:g} mm",
            action=f"Give a length that the thesis tried, such as {E_MM:g} mm.",
        )
    if not REFUSED_SHARE_RANGE[0] <= refused_share <= REFUSED_SHARE_RANGE[1]:
        raise BadParameter(
            "the refused share is out of range",
            limit=f"{REFUSED_SHARE_RANGE[0]:g} to {REFUSED_SHARE_RANGE[1]:g}",
            got=f"{refused_share:g}",
            action="Give the share of correct pairings that the validation may refuse, such as "
            f"{REFUSED_SHARE:g}.",
        )
