"""Illumination across the sensor from ring light and lens, and the background light."""

from __future__ import annotations

import numpy as np

from sim.basler.optics.canvas import Area, Image
from sim.world.noise import noise

# Light returned by the film at the working distance: a sphere reaches 200 of 255 at 4 ms and lowest gain.
FILM_ELECTRONS_PER_US = 2.0
BACKGROUND_ELECTRONS_PER_US = 0.04  # drapes and skin between the spheres
SLOPE = 0.05  # of the light from the centre of the sensor to its edge, at most
BACKGROUND_SLOPE = 0.4
FALL_OFF = 0.06  # towards the corners


class Lighting:
    """The light of one camera: its own gradient, and a fall-off towards the corners."""

    def __init__(self, seed: int, serial: str, sensor_px: tuple[int, int]) -> None:
        self._centre = np.array([sensor_px[0] - 1, sensor_px[1] - 1]) / 2
        self._half_width_px = sensor_px[0] / 2
        slopes = noise(seed, f"light of camera {serial}", 0).uniform(-1.0, 1.0, 4)
        self._slope = slopes[:2] * SLOPE
        self._background_slope = slopes[2:] * BACKGROUND_SLOPE

    def on_film(self, area: Area) -> Image:
        """Electrons per microsecond (height, width) from a film of unit brightness."""
        return self._surface(area, self._slope, FALL_OFF) * np.float32(FILM_ELECTRONS_PER_US)

    def on_background(self, area: Area) -> Image:
        """Electrons per microsecond (height, width) from an empty background."""
        return self._surface(area, self._background_slope, 0.0) * np.float32(BACKGROUND_ELECTRONS_PER_US)

    def _surface(self, area: Area, slope: np.ndarray, fall_off: float) -> Image:
        x = (area.x + np.arange(area.width) - self._centre[0]) / self._half_width_px
        y = (area.y + np.arange(area.height) - self._centre[1]) / self._half_width_px
        columns = 1.0 + slope[0] * x - fall_off * x * x
        rows = slope[1] * y - fall_off * y * y
        total: Image = rows.astype(np.float32)[:, None] + columns.astype(np.float32)[None, :]
        return total
