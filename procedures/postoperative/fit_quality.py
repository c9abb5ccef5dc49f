"""Judges a fitted rod or hole: whether the fit can be relied on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_BOUND = 1e-3  # of the range between the two bounds


@dataclass(frozen=True)
class FitQuality:
    """Whether the scan shows all that is needed, and the fit converged with its position parameters within
    bounds; residual, HU; radius, mm.
    """

    whole: bool
    ended: bool
    inside: bool
    residual_hu: float
    radius_mm: float


@dataclass(frozen=True)
class Usual:
    """What fits of real objects leave: the largest residual in HU, and the range of radii in mm."""

    residual_hu: float
    radius_mm: tuple[float, float]

    def failures(self, quality: FitQuality) -> tuple[str, ...]:
        """Why position and direction are unknown."""
        why = []
        if not quality.whole:
            why.append("the CT ends there")
        if not quality.ended:
            why.append("the fit did not converge")
        if not quality.inside:
            why.append("position, direction or radius ended at a limit of the fit")
        return tuple(why)

    def doubts(self, quality: FitQuality) -> tuple[str, ...]:
        """Why they may be wrong."""
        why = []
        if quality.residual_hu > self.residual_hu:
            why.append(
                f"the residual of the fit is {quality.residual_hu:.0f} HU, normally up to "
                f"{self.residual_hu:g} HU"
            )
        low_mm, high_mm = self.radius_mm
        if not low_mm <= quality.radius_mm <= high_mm:
            why.append(f"its radius of {quality.radius_mm:.2f} mm is not within {low_mm:g} to {high_mm:g} mm")
        return tuple(why)


def at_bound(found: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Which parameters (n,) ended at a bound."""
    close = AT_BOUND * (high - low)
    return np.asarray((found - low < close) | (high - found < close))
