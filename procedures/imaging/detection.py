"""Detects candidate spheres in a whole volume: a matched filter on a coarse grid.

The volume is resampled to about a millimetre, clipped so that bone and metal do not outshine a polymer
sphere, and correlated with a kernel that compares the mean inside a ball with the mean of a surrounding
shell. The response is therefore a contrast in HU.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

VOXELS_PER_RADIUS = 5.75  # a 1 mm grid for the usual 11.5 mm sphere
CLIP_HU = (-1000.0, 300.0)  # air to dense polymer
BALL_TO = 0.90  # of the radius: safely inside despite blur
SHELL_FROM, SHELL_TO = 1.15, 1.53  # of the radius
MIN_CONTRAST_HU = 450.0  # a polymer sphere in air shows about 1000, one touching skin half of that
SEPARATION = 1.2  # of the radius: weaker peaks closer to a stronger one are the same object
MAX_PEAKS = 200


@dataclass(frozen=True, eq=False)
class Peak:
    """A local maximum of the filter: grid position (slice, row, column) mm and contrast in HU."""

    position_mm: Array
    contrast_hu: float


def find_peaks(volume: Volume, radius_mm: float) -> tuple[Peak, ...]:
    """Local maxima of the sphere filter, strongest first."""
    coarse, step_mm = _resample(volume, radius_mm / VOXELS_PER_RADIUS)
    response = _correlate(coarse, _kernel(radius_mm, step_mm))
    places = np.argwhere(response > MIN_CONTRAST_HU)
    strengths = response[tuple(places.T)]
    order = np.argsort(-strengths, kind="stable")
    places_mm = places[order] * step_mm
    strengths = strengths[order]
    peaks: list[Peak] = []
    free = np.ones(len(places_mm), dtype=bool)
    while free.any() and len(peaks) < MAX_PEAKS:
        best = int(np.argmax(free))
        # offset between voxel centres of the coarse grid and of the volume
        offset_mm = 0.5 * (step_mm - volume.geometry.spacing_mm)
        peaks.append(Peak(places_mm[best] + offset_mm, float(strengths[best])))
        free &= np.linalg.norm(places_mm - places_mm[best], axis=1) > SEPARATION * radius_mm
    return tuple(peaks)


def _resample(volume: Volume, step_mm: float) -> tuple[NDArray[np.float32], Array]:
    """HU above air on a coarse grid of about `step_mm`, and its exact spacing (3,) mm."""
    slices, rows, columns = volume.geometry.shape
    counts = np.maximum(np.rint(volume.extent_mm / step_mm).astype(int), 1)
    planes = np.empty((slices, counts[1], counts[2]), dtype=np.float32)
    smaller = counts[1] <= rows and counts[2] <= columns
    for number, plane in enumerate(volume.voxels):
        clipped = np.clip(plane, int(CLIP_HU[0]), int(CLIP_HU[1])).astype(np.float32)
        cv2.resize(
            clipped,
            (int(counts[2]), int(counts[1])),
            dst=planes[number],
            interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR,
        )
    planes -= CLIP_HU[0]
    if counts[0] != slices:
        flat = planes.reshape(slices, -1)
        resized = _average_slices(flat, counts[0]) if counts[0] < slices else _between_slices(flat, counts[0])
        planes = resized.reshape(counts)
    return planes, volume.extent_mm / counts


def _between_slices(flat: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    place = np.clip((np.arange(count) + 0.5) * len(flat) / count - 0.5, 0, len(flat) - 1)
    below = np.minimum(place.astype(int), max(len(flat) - 2, 0))
    share = (place - below).astype(np.float32)[:, None]
    above = np.minimum(below + 1, len(flat) - 1)
    return np.asarray(flat[below] * (1 - share) + flat[above] * share)


def _average_slices(flat: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    edges = np.arange(count + 1) * len(flat) / count
    result = np.empty((count, flat.shape[1]), dtype=np.float32)
    for number, (low, high) in enumerate(pairwise(edges.tolist())):
        cells = np.arange(int(low), min(int(np.ceil(high)), len(flat)))
        cover = np.minimum(cells + 1, high) - np.maximum(cells, low)
        np.dot((cover / cover.sum()).astype(np.float32), flat[cells[0] : cells[-1] + 1], out=result[number])
    return result


def _kernel(radius_mm: float, step_mm: Array) -> NDArray[np.float32]:
    half_sides = np.ceil(SHELL_TO * radius_mm / step_mm).astype(int)
    grid = np.meshgrid(
        *(np.arange(-r, r + 1) * step for r, step in zip(half_sides, step_mm, strict=True)), indexing="ij"
    )
    distance = np.linalg.norm(grid, axis=0) / radius_mm
    ball = distance < BALL_TO
    shell = (distance > SHELL_FROM) & (distance < SHELL_TO)
    return np.asarray(ball / ball.sum() - shell / shell.sum(), dtype=np.float32)


def _correlate(values: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    # outside the volume counts as air; the kernel is symmetric, so convolution equals correlation
    middle = [k // 2 for k in kernel.shape]
    shape = [fft.next_fast_len(n + k, real=True) for n, k in zip(values.shape, middle, strict=True)]
    # axis by axis: lines on which the small kernel is still zero are not transformed
    spectrum = fft.rfft(kernel, n=shape[2], axis=2)
    for axis in (1, 0):
        spectrum = fft.fft(spectrum, n=shape[axis], axis=axis, overwrite_x=True)
    spectrum *= fft.rfftn(values, s=shape)
    response = fft.irfftn(spectrum, s=shape, overwrite_x=True)
    return np.asarray(response[tuple(slice(k, k + n) for k, n in zip(middle, values.shape, strict=True))])
