"""Gaussian blur of a patch of light."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Image, row_bands

KERNEL_LIMIT_PX = 2.5  # above, three box filters are as good (their sum is nearly normal) and faster
SPREAD_SIGMAS = 3.5  # what is farther away adds less than 0.05 %


def spread_px(sigma_px: float) -> int:
    """How far the blur spreads light."""
    return ceil(SPREAD_SIGMAS * sigma_px) + 1


def blurred(patch: Image, sigma_px: float) -> Image:
    """The patch (rows, columns) convolved with a Gaussian; its border is extended outwards."""
    if sigma_px <= KERNEL_LIMIT_PX:
        spread = spread_px(sigma_px)
        steps = np.arange(-spread, spread + 1)
        kernel = np.exp(-0.5 * (steps / sigma_px) ** 2)
        kernel = (kernel / kernel.sum()).astype(np.float32)
        return _smoothed(patch, kernel)
    # Variance of a box of w pixels is (w^2 - 1) / 12; three of them add up. Only odd widths stay centred.
    ideal = (4.0 * sigma_px**2 + 1.0) ** 0.5
    small = int(ideal) - (1 - int(ideal) % 2)
    # number of boxes of the smaller width for which the total variance is nearest to the target
    count = round((12 * sigma_px**2 - 3 * (small * small + 4 * small + 3)) / (-4 * small - 4))
    for index in range(3):
        width = small if index < count else small + 2
        patch = _box(_box(patch, width, 0), width, 1)
    return patch


def _smoothed(patch: Image, kernel: Image) -> Image:
    """Along the columns, then along the rows, a few rows at a time."""
    spread = len(kernel) // 2
    padded = _continued(patch, spread, 0)
    smooth = np.empty_like(patch)
    for rows in row_bands(*patch.shape):
        down = _weighed(padded[rows.start : rows.stop + 2 * spread], kernel, 0)
        smooth[rows] = _weighed(_continued(down, spread, 1), kernel, 1)
    return smooth


def _weighed(padded: Image, kernel: Image, axis: int) -> Image:
    """Convolution along an axis, which becomes shorter by the kernel's length less one."""
    spread = len(kernel) // 2
    length = padded.shape[axis] - 2 * spread

    def shifted(step: int) -> Image:
        return padded[step : step + length] if axis == 0 else padded[:, step : step + length]

    total: Image = shifted(spread) * kernel[spread]
    pair = np.empty_like(total)
    for step in range(spread):  # the kernel is symmetric: one multiplication for two taps
        np.add(shifted(step), shifted(2 * spread - step), out=pair)
        pair *= kernel[step]
        total += pair
    return total


def _box(patch: Image, width: int, axis: int) -> Image:
    spread = width // 2
    sums: NDArray[np.float64] = np.cumsum(_continued(patch, spread, axis), axis=axis, dtype=np.float64)
    first = np.zeros_like(sums[:1] if axis == 0 else sums[:, :1])
    sums = np.concatenate([first, sums], axis=axis)
    ends = sums[width:] - sums[:-width] if axis == 0 else sums[:, width:] - sums[:, :-width]
    mean: Image = (ends / width).astype(np.float32)
    return mean


def _continued(patch: Image, spread: int, axis: int) -> Image:
    margin = ((spread, spread), (0, 0)) if axis == 0 else ((0, 0), (spread, spread))
    padded: Image = np.pad(patch, margin, mode="edge")
    return padded
