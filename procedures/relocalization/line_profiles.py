"""Profiles across a laser line: the light in a window around it in each row, and filters on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from procedures.relocalization.grey_image import GreyImage, highest_grey
from procedures.relocalization.line_ridges import Ridges, mark_changes
from ronna_hw.arrays import Array

EDGE_PX = 4  # at either end of a profile, for the level of the light beside the line
WIDTH_SAMPLING = 3  # every third row tells the width
WIDTH_OVER_SIGMA = 2.355  # of a Gaussian at half height

Narrow = NDArray[np.float32]
OF_EDGE = np.full(EDGE_PX, 0.5 / EDGE_PX, np.float32)


@dataclass(frozen=True)
class WeighedRows:
    """Light under a filter's bell in each row: places in units of its width, and the light there, (n, m)."""

    places: Narrow
    light: Narrow
    sigma_px: float

    @property
    def total(self) -> Narrow:
        """Light under the bell in each row."""
        return np.asarray(np.einsum("ij->i", self.light))

    @property
    def answer(self) -> tuple[Array, Array]:
        """Excess of light on the right in each row, and its slope per px with the centre."""
        moved = self.places * self.light
        score = np.einsum("ij->i", moved).astype(float)
        slope = (self.total - np.einsum("ij,ij->i", self.places, moved)).astype(float) / self.sigma_px
        return score, slope


class LineProfiles:
    """Windows across the line, one a row: light, columns, and the filter's answers at the present centres."""

    def __init__(
        self, grey: GreyImage, light: GreyImage, room: GreyImage | None, ridges: Ridges, half_px: int
    ) -> None:
        half_px = min(half_px, (light.shape[1] - 1) // 2)
        start = np.rint(ridges.column).astype(np.int64) - half_px
        start = start.clip(0, light.shape[1] - 2 * half_px - 1)
        width = 2 * half_px + 1
        profile = _cut_windows(light, ridges.row, start, width).astype(np.float32)
        ends = profile[:, :EDGE_PX] @ OF_EDGE + profile[:, -EDGE_PX:] @ OF_EDGE
        self.light = profile
        self.light -= ends[:, None]
        bright = _cut_windows(grey, ridges.row, start, width)
        self._clipped = bright >= highest_grey(grey) if bright.max() >= highest_grey(grey) else None
        columns = start[:, None] + np.arange(width)
        self._columns: Narrow = columns.astype(np.float32)
        self._room = None if room is None else _cut_windows(room, ridges.row, start, width)

    def weigh(self, centre: Array, sigma_px: float) -> WeighedRows:
        """Lay a Gaussian of this width over each row."""
        t: Narrow = self._columns - centre[:, None].astype(np.float32)
        t *= np.float32(1.0 / sigma_px)
        bell = t * t
        bell *= np.float32(-0.5)
        np.exp(bell, out=bell)
        bell *= self.light
        return WeighedRows(t, bell, sigma_px)

    def room(self, rows: WeighedRows) -> tuple[Array, Array, Array]:
        """Return the room's light in each row by the filter's score, by its bell, and the bell's sum."""
        if self._room is None:
            none = np.zeros(len(rows.places))
            return none, none, none
        seen = rows.light * self._room
        score, light = np.einsum("ij,ij->i", rows.places, seen), np.einsum("ij->i", seen)
        return score.astype(float), light.astype(float), rows.total.astype(float)

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
        rows = np.flatnonzero(self._clipped) // self._clipped.shape[1]
        rows = rows[mark_changes(rows)]
        core = np.abs(self._columns[rows] - centre[rows, None]) < sigma_px
        share[rows] = (self._clipped[rows] & core).sum(axis=1) / np.maximum(core.sum(axis=1), 1)
        return share


def _cut_windows(image: GreyImage, row: NDArray[np.int64], start: NDArray[np.int64], width: int) -> GreyImage:
    """Return `width` pixels of each row, from its start; copied as pieces, not pixel by pixel."""
    rows, columns = image.shape
    windows = as_strided(image, (rows, columns - width + 1, width), (*image.strides, image.strides[1]))
    cut: GreyImage = windows[row, start]  # type: ignore[assignment]  # NumPy widens the dtype
    return cut


def _first_below(falling: Array, level: float) -> float:
    """Return where values first fall below a level, interpolated."""
    after = int(np.argmax(falling < level))
    if not after:
        return float(len(falling))
    step = falling[after - 1] - falling[after]
    return float(after - 1 + (falling[after - 1] - level) / step)
