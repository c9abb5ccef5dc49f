"""Figures of one measurement of a ball with the stereo head."""

from __future__ import annotations

import math
from collections.abc import Iterator

from procedures.reporting.calibration.figures import AXES, Figure, Figures, Matrix3, Numbers
from procedures.reporting.numbers import micrometres, millimetres
from ronna_hw.calibration import Numbers2, Numbers3


class OutlineFigures(Numbers):
    """The ball's outline in one image, full-sensor pixels, major semi-axis first."""

    centre_px: Numbers2
    axes_px: Numbers2
    quality: float
    status: str
    rim_fraction: float
    scatter_px: float
    blur_px: float


class BallFigures(Figures):
    """The ball in the tool frame and in both images."""

    position_mm: Numbers3
    covariance_mm2: Matrix3
    ray_gap_mm: float
    radius_mm: float
    left: OutlineFigures
    right: OutlineFigures

    def table(self) -> Iterator[Figure]:
        """The ball in the tool frame."""
        for number, axis in enumerate(AXES):
            sigma_mm = math.sqrt(self.covariance_mm2[number][number])
            yield Figure(
                f"ball in the tool frame, {axis}, mm",
                f"{self.position_mm[number]:.4f}",
                f"{sigma_mm:.4f}",
            )
        yield Figure("gap of the lines of sight, µm", micrometres(self.ray_gap_mm))
        yield Figure("radius, mm", millimetres(self.radius_mm))
