"""Localizer and matcher of a case: ours, or those of the thesis, which are not for clinical use.

Free of numerics, since every command imports this at start-up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

NOT_CLINICAL = "not for clinical use"

E_RANGE_MM = (1.0, 6.0)  # as tried in the thesis, 5.3.1
# Comes nearest to the thesis' figures for five to eight spheres; the thesis states no single value.
E_MM = 2.5
REFUSED_SHARE_RANGE = (1e-6, 0.5)
REFUSED_SHARE = 1e-3  # ours, as the thesis states no rule for its validation


class Localizer(StrEnum):
    """Localizer of the spheres in the CT."""

    OURS = "ours"
    THESIS_LINE = "thesis-line"
    THESIS_SPHERE = "thesis-sphere"


class Matcher(StrEnum):
    """Pairing of the spheres in CT and room."""

    OURS = "ours"
    THESIS = "thesis"


@dataclass(frozen=True, kw_only=True)
class CaseMethods:
    """Localizer and matcher of a case; `e_mm` and `refused_share` are of the thesis' matcher."""

    # for request files and tapes, whose text holds an enumeration by its value
    __pydantic_config__ = {"strict": False, "extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    localizer: Localizer = Localizer.OURS
    matcher: Matcher = Matcher.OURS
    e_mm: float = E_MM
    refused_share: float = REFUSED_SHARE

    def describe(self) -> str:
        """Name the methods with their mark, or return '' if both are ours."""
        if self.localizer is Localizer.OURS and self.matcher is Matcher.OURS:
            return ""
        matcher = str(self.matcher)
        if self.matcher is Matcher.THESIS:
            matcher += f" (e {self.e_mm:g} mm, refused share {self.refused_share:g})"
        return f"localizer {self.localizer}, matcher {matcher}: {NOT_CLINICAL}"
