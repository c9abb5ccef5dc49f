"""Profiles across a laser line: the light in a window around it in each row, and filters on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.grey_image import GreyImage, highest_grey
from procedures.relocalization.line_ridges import Ridges
from ronna_hw.arrays import Array

EDGE_PX = 4  # at either end of a profile, for the level of the light beside the line
WIDTH_SAMPLING = 3  # every third row tells the width
WIDTH_OVER_SIGMA = 2.355  # of a Gaussian at half height

Narrow = NDArray[np.float32]


class LineProfiles:
    """Windows across the line, one a row: light, columns, and the filter's answers at the present centres."""

    def __init__(
        self, grey: GreyImage, light: GreyImage, room: GreyImage | None, ridges: Ridges, half_px: int
    ) -> None:
        half_px = min(half_px, (light.shape[1] - 1) // 2)
        start = np.clip(np.rint(ridges.column).astype(np.int64) - half_px, 0, None)
        start = np.minimum(start, light.shape[1] - 2 * half_px - 1)
        columns = start[:, None] + np.arange(2 * half_px + 1)
        places = ridges.row[:, None] * light.shape[1] + columns
        profile = light.ravel().take(places).astype(np.float32)
        ends = 0.5 * (profile[:, :EDGE_PX].mean(axis=1) + profile[:, -EDGE_PX:].mean(axis=1))
        self.light = profile - ends[:, None]
        bright = grey.ravel().take(places)
        self._clipped = bright >= highest_grey(grey) if bright.max() >= highest_grey(grey) else None
        self._columns = columns.astype(np.float32)
        self._room = None if room is None else room.ravel().take(places)

    def answer(self, centre: Array, sigma_px: float) -> tuple[Array, Array]:
        """Return what each row shows more on the right, and how that grows per px with the centre."""
        t, square, bell = self._weigh(centre, sigma_px)
        score = np.einsum("ij,ij->i", t, bell).astype(float)
        slope = (bell.sum(axis=1) - np.einsum("ij,ij->i", square, bell)).astype(float) / sigma_px
        return score, slope

    def _weigh(self, centre: Array, sigma_px: float) -> tuple[Narrow, Narrow, Narrow]:
        """Return places in units of the filter's width, their squares, and the light under its bell."""
        t = self._columns - centre[:, None].astype(np.float32)
        t *= np.float32(1.0 / sigma_px)
        square = t * t
        bell = np.exp(np.float32(-0.5) * square)
        bell *= self.light
        return t, square, bell

    def room(self, centre: Array, sigma_px: float) -> tuple[Array, Array, Array]:
        """Return the room's light in each row by the filter's score, by its bell, and the bell's sum."""
        if self._room is None:
            none = np.zeros(len(centre))
            return none, none, none
        t, _, bell = self._weigh(centre, sigma_px)
        seen = bell * self._room
        score = np.einsum("ij,ij->i", t, seen)
        return score.astype(float), seen.sum(axis=1).astype(float), bell.sum(axis=1).astype(float)

    def core_sigma_px(self, centre: Array) -> float:
        """Return the width of the mean profile at half height, as a standard deviation."""
        sampled = slice(None, None, WIDTH_SAMPLING)
        offset = np.rint(self._columns[sampled] - centre[sampled, None]).astype(np.int64)
        reach = int(np.abs(offset).max())
        sums = np.bincount((offset + reach).ravel(), self.light[sampled].ravel())
        counts = np.bincount((offset + reach).ravel())
        mean = sums / np.maximum(counts, 1)
        half = 0.5 * mean[max(0, reach - 1) : reach + 2].mean()
        sides = [_first_below(mean[reach:], half), _first_below(mean[reach::-1], half)]
        return sum(sides) / WIDTH_OVER_SIGMA

    def clipped_share(self, centre: Array, sigma_px: float) -> Array:
        """Return the saturated share of each row's core."""
        if self._clipped is None:
            return np.zeros(len(centre))
        share = np.zeros(len(centre))
        rows = np.flatnonzero(self._clipped.any(axis=1))
        core = np.abs(self._columns[rows] - centre[rows, None]) < sigma_px
        share[rows] = (self._clipped[rows] & core).sum(axis=1) / np.maximum(core.sum(axis=1), 1)
        return share


def _first_below(falling: Array, level: float) -> float:
    """Return where values first fall below a level, interpolated."""
    after = int(np.argmax(falling < level))
    if not after:
        return float(len(falling))
    step = falling[after - 1] - falling[after]
    return float(after - 1 + (falling[after - 1] - level) / step)
