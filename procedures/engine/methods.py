"""Methods of a case, with the mark of those that are not for clinical use.

Free of numerics, since every command imports this at start-up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.registration.thesis_settings import E_MM, REFUSED_SHARE, check_thesis_settings

NOT_CLINICAL = "not for clinical use"


class HeadStart(StrEnum):
    """Source of the head's coarse pose before a scan of the skin."""

    LANDMARKS = "landmarks"  # nose and ears, touched with a pointer
    SCAN = "scan"  # a few looks, taken where somebody has measured the head roughly


class Matcher(StrEnum):
    """Pairing of the spheres in CT and room."""

    OURS = "ours"
    THESIS = "thesis"

    @property
    def is_clinical(self) -> bool:
        """Whether a patient may depend on it."""
        return self is Matcher.OURS


@dataclass(frozen=True, kw_only=True)
class CaseMethods:
    """Localizer and matcher of a case; `e_mm` and `refused_share` are of the thesis' matcher.

    `start` is of a case on the skin, whose head has no spheres to be matched.
    With `enhance_contrast` the stereo head's pictures are equalized before their edges are sought (1.4).
    Raises REG-007 if one of the two is out of range.
    """

    # for request files and tapes, whose text holds an enumeration by its value
    __pydantic_config__: ClassVar = {"strict": False, "extra": "forbid", "allow_inf_nan": False}

    localizer: Localizer = Localizer.OURS
    matcher: Matcher = Matcher.OURS
    e_mm: float = E_MM
    refused_share: float = REFUSED_SHARE
    enhance_contrast: bool = False
    start: HeadStart = HeadStart.LANDMARKS

    def __post_init__(self) -> None:
        check_thesis_settings(self.e_mm, self.refused_share)

    def describe(self) -> str:
        """Name the methods with their mark, or return '' if all are for clinical use."""
        is_clinical = LOCALIZERS[self.localizer].is_clinical and self.matcher.is_clinical
        if is_clinical and not self.enhance_contrast:
            return ""
        matcher = str(self.matcher)
        if self.matcher is Matcher.THESIS:
            matcher += f" (e {self.e_mm:g} mm, refused share {self.refused_share:g})"
        contrast = ", contrast enhanced" if self.enhance_contrast else ""
        return f"localizer {self.localizer}, matcher {matcher}{contrast}: {NOT_CLINICAL}"
