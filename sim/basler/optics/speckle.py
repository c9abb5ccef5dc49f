"""Speckle: the grain that coherent light has in an image, set by the lens's aperture.

A pattern is the squared magnitude of random waves through a round aperture. Skin depolarises light and the
laser's band is finite: independent patterns add up, and the contrast falls with the root of their number.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.gige_vision import PIXEL_PITCH_UM
from sim.basler.optics.canvas import EFFECTIVE_F_NUMBER, Image
from sim.world.noise import noise

TILE_PX = 256  # a pattern repeats beyond: it is wider than a line; a power of two
OVERSAMPLED = 2  # a pixel integrates over its area
PATTERNS = 8  # independent ones in depolarised light of a laser diode (U): contrast 0.35
WAVELENGTH_UM = 0.85
SPECKLE_CONTRAST = PATTERNS**-0.5  # before the pixels average over grains


class Speckle:
    """Speckle of one camera at one moment, as a factor of mean 1 at each pixel."""

    def __init__(self, seed: int, camera: str, moment: int) -> None:
        """Choose a pattern; `moment` changes with the place of head and camera, which changes all grains."""
        self._tile = _tile(seed, camera)
        self._right, self._down = noise(seed, f"speckle of camera {camera}", moment).integers(0, TILE_PX, 2)

    def at(self, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> Image:
        """Return the factors at pixels of the sensor."""
        place = ((rows + self._down) & (TILE_PX - 1)) * TILE_PX + ((columns + self._right) & (TILE_PX - 1))
        return np.asarray(self._tile.ravel().take(place))


@lru_cache(maxsize=4)
def _tile(seed: int, camera: str) -> Image:
    size = TILE_PX * OVERSAMPLED
    frequency = np.fft.fftfreq(size, PIXEL_PITCH_UM / OVERSAMPLED)
    aperture = np.hypot(frequency[:, None], frequency) < 0.5 / (WAVELENGTH_UM * EFFECTIVE_F_NUMBER)
    generator = noise(seed, f"speckle tile of camera {camera}", 0)
    total = np.zeros((size, size))
    for _ in range(PATTERNS):
        waves = generator.standard_normal((2, size, size))
        total += np.abs(np.fft.ifft2((waves[0] + 1j * waves[1]) * aperture)) ** 2
    pixels = total.reshape(TILE_PX, OVERSAMPLED, TILE_PX, OVERSAMPLED).mean(axis=(1, 3))
    return np.asarray(pixels / pixels.mean(), dtype=np.float32)
