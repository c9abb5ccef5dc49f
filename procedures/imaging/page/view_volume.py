"""A CT reduced to fit into a page: fewer voxels, 8 bits, all slices in one JPEG."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import Volume, VoxelGeometry

MOST_VOXELS = 256  # along each axis: a page of a few megabytes that a phone can still show
DARKEST_HU, BRIGHTEST_HU = -1024.0, 2048.0  # air to cortical bone; metal is white
LEVELS = 255
JPEG_QUALITY = 88


@dataclass(frozen=True, eq=False)
class ViewVolume:
    """Voxels (slices, rows, columns) as grey levels, 0 at -1024 HU and 255 at 2048 HU, with geometry."""

    grey: NDArray[np.uint8]
    geometry: VoxelGeometry


def view_volume(volume: Volume) -> ViewVolume:
    """Means over whole blocks of voxels, at most 256 along each axis; incomplete blocks are dropped."""
    geometry = volume.geometry
    factor = [-(-count // MOST_VOXELS) for count in geometry.shape]
    shape = tuple(count // by for count, by in zip(geometry.shape, factor, strict=True))
    slices, rows, columns = shape
    kept = [slice(0, count * by) for count, by in zip(shape, factor, strict=True)]
    grey = np.empty(shape, np.uint8)
    for number in range(slices):  # slice by slice: a whole volume of floats would be large
        block = volume.voxels[number * factor[0] : (number + 1) * factor[0], kept[1], kept[2]]
        mean_hu = block.reshape(factor[0], rows, factor[1], columns, factor[2]).mean(axis=(0, 2, 4))
        share = (mean_hu - DARKEST_HU) / (BRIGHTEST_HU - DARKEST_HU)
        grey[number] = np.round(LEVELS * np.clip(share, 0.0, 1.0))
    by = np.array(factor)
    return ViewVolume(
        grey,
        VoxelGeometry(
            (slices, rows, columns),
            geometry.to_patient_mm((by - 1) / 2),  # centre of the first block
            geometry.axes,
            geometry.spacing_mm * by,
        ),
    )


def mosaic(view: ViewVolume) -> tuple[bytes, int]:
    """A JPEG of all slices tiled row by row, and the number of slices per row."""
    import cv2

    slices, rows, columns = view.grey.shape
    across = math.isqrt(slices - 1) + 1
    down = -(-slices // across)
    tiles = np.zeros((across * down, rows, columns), np.uint8)
    tiles[:slices] = view.grey
    picture = tiles.reshape(down, across, rows, columns).swapaxes(1, 2).reshape(down * rows, across * columns)
    _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(encoded), across
