"""Coarse course of a laser line in an image: ridges of light, one branch for each piece that hangs together.

At the edge of an ear or nose the line jumps, and one row shows it twice; hair leaves gaps. Every piece is a
branch of its own. All is done on a reduced image, where speckle is averaged away.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.grey_image import GreyImage, highest_grey, single_threaded
from ronna_hw.arrays import Array, Mask

HALVINGS = 2  # a line is some 15 px wide, and 4 px in the reduced image
# The rest in pixels of the reduced image
ACROSS_SIGMA, ALONG_SIGMA = 1.5, 3.0  # of the smoothing, against speckle
WIDEST = 65  # the mean over this width is taken for ambient light
APART = 17  # two ridges in a row are no closer
IN_SHADE_OF, SHADED = 65, 5  # near a ridge, one with less than a fifth of its light is its halo
# Places whose neighbours within `APART` make up the shade, half of that apart: so it ends with the image.
REST_OF_SHADE = np.zeros((1, IN_SHADE_OF - APART + 1), np.uint8)
REST_OF_SHADE[0, :: APART // 2] = 1
SHORTEST = 6  # rows of a branch
NOISE_FACTOR = 8.0
CONTRAST_FLOOR = 0.015  # of the grey range
FINER_GREY = 16  # steps of a grey value: OpenCV is fastest on whole numbers
NOISE_SAMPLING = 3  # every third pixel suffices
LOW_PERCENTILE, MIDDLE_PERCENTILE = 16.0, 50.0  # one standard deviation apart; the line does not reach either


@dataclass(frozen=True)
class Ridges:
    """Rough centre of the line in each row of the branches, in pixels of the whole image.

    `row`, `column` and `branch` are (n,), in order of branches and of their rows, every row once a branch.
    """

    row: NDArray[np.int64]
    column: Array
    branch: NDArray[np.int64]
    strongest_grey: float
    limit_grey: float


def find_ridges(small: GreyImage) -> Ridges:
    """Find the branches of a line that crosses the rows of an image, `HALVINGS` times halved; maybe none."""
    with single_threaded():
        first, small = _crop_to_light(small)
        smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), sigmaX=ACROSS_SIGMA, sigmaY=ALONG_SIGMA)
        fine = (FINER_GREY * smooth).astype(np.uint16)
        ridge = cv2.subtract(fine, cv2.blur(fine, (WIDEST, 1)))
        sample = ridge[::NOISE_SAMPLING, ::NOISE_SAMPLING]
        low, middle = _percentiles(sample, (LOW_PERCENTILE, MIDDLE_PERCENTILE))
        limit = max(middle + NOISE_FACTOR * (middle - low), CONTRAST_FLOOR * FINER_GREY * highest_grey(small))
        beside = cv2.dilate(ridge, np.ones((1, APART), np.uint8))
        around = cv2.dilate(beside, REST_OF_SHADE)
        is_peak = (ridge >= beside) & (ridge > limit) & (ridge > around // SHADED)
        joined = cv2.dilate(is_peak.astype(np.uint8), np.ones((3, 3), np.uint8))
        _, labels = cv2.connectedComponents(joined, connectivity=8)
    rows, columns = np.divmod(np.flatnonzero(is_peak), is_peak.shape[1])
    branches = _trace_branches(rows, columns + first, labels[rows, columns], 2**HALVINGS)
    strongest, limit = float(ridge.max()) / FINER_GREY, limit / FINER_GREY
    if not branches:
        none = np.zeros(0, np.int64)
        return Ridges(none, np.zeros(0), none, strongest, limit)
    row, column = (np.concatenate(each) for each in zip(*branches, strict=True))
    branch = np.repeat(np.arange(len(branches)), [len(each[0]) for each in branches])
    return Ridges(row, column, branch, strongest, limit)


def _crop_to_light(small: GreyImage) -> tuple[int, GreyImage]:
    """Return the columns, and the first of them, within which any pixel may belong to a line."""
    lit = np.flatnonzero(small.max(axis=0) > CONTRAST_FLOOR * highest_grey(small))
    if not len(lit):
        return 0, small
    first = max(int(lit[0]) - WIDEST, 0)
    near: GreyImage = np.ascontiguousarray(small[:, first : int(lit[-1]) + WIDEST])  # type: ignore[assignment]  # NumPy widens the dtype
    return first, near


def _percentiles(values: NDArray[np.uint16], percentages: tuple[float, ...]) -> list[float]:
    """Return percentiles with linear interpolation; whole numbers are sorted fastest by their digits."""
    ordered = np.sort(values, axis=None, kind="stable")
    places = np.array(percentages) / 100.0 * (ordered.size - 1)
    return [float(each) for each in np.interp(places, np.arange(ordered.size), ordered)]


def mark_changes(values: NDArray[np.int64]) -> Mask:
    """Mark the first value, and each that differs from the one before."""
    is_new = np.ones(len(values), bool)
    np.not_equal(values[1:], values[:-1], out=is_new[1:])
    return is_new


def runs_along_rows(small: GreyImage) -> bool:
    """Return whether the line crosses more columns than rows, and the image should be transposed."""
    low, high = int(small.min()), int(small.max())
    is_bright = small > (low + high) // 2
    return bool(is_bright.any(axis=0).sum() > is_bright.any(axis=1).sum())


def _trace_branches(
    rows: NDArray[np.intp], columns: NDArray[np.intp], labels: NDArray[np.int32], factor: int
) -> list[tuple[NDArray[np.int64], Array]]:
    """Return rows and columns of the whole image for each label with enough rows."""
    branches = []
    for label in np.flatnonzero(np.bincount(labels)):
        own = labels == label
        every = rows[own]
        is_first = mark_changes(every)
        at, index = every[is_first], np.cumsum(is_first) - 1
        if at[-1] - at[0] + 1 < SHORTEST:
            continue
        middle = np.bincount(index, columns[own]) / np.bincount(index)
        whole = np.arange(factor * at[0], factor * (at[-1] + 1))
        column = np.interp((whole + 0.5) / factor - 0.5, at, middle)
        branches.append((whole.astype(np.int64), np.asarray(factor * (column + 0.5) - 0.5)))
    return branches
