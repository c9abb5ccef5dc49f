"""Measurement of a sphere in one image, and whether its centre may be used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum


class SphereStatus(StrEnum):
    """Whether a centre may be used for a measurement."""

    OK = "OK"
    UNRELIABLE = "UNRELIABLE"


@dataclass(frozen=True)
class SphereImage:
    """A sphere in an image. (0, 0) is the centre of the top-left pixel; perspective bias not removed.

    `axes_px` are semi-axes, major first. `quality` 0..1 falls with lost rim, scatter and noise.
    `covariance_px2` is that of the centre, x and y. `rim_fraction` is the visible share of the rim. `doubt`
    is the reason for UNRELIABLE.
    """

    centre_px: tuple[float, float]
    axes_px: tuple[float, float]
    quality: float
    status: SphereStatus
    covariance_px2: tuple[tuple[float, float], tuple[float, float]]
    rim_fraction: float
    scatter_px: float
    blur_px: float
    doubt: str = ""

    def shifted(self, offset_x_px: float, offset_y_px: float) -> SphereImage:
        """The same sphere in full-sensor pixels, given the offsets of the region of interest."""
        x, y = self.centre_px
        return replace(self, centre_px=(x + offset_x_px, y + offset_y_px))
