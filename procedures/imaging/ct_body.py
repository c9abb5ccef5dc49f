"""Body of a head in a CT and the air around it, on a coarse grid: where to look for its surface.

Headrest, tubes and cables are other bodies, or thin ones that an opening takes off. Air that is reached only
through a narrow channel (nose, mouth, ear canals, sinuses) is inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arrays import Array, Mask

COARSE_MM = 2.0
FINE_MM = 1.0  # finer voxels are averaged: the scanner's blur is wider
THIN_MM = 3.0  # radius of an opening: cables and tubes are thinner, ears are not
REGROWN_MM = 8.0  # what the opening took off a rim of the body
CHANNEL_MM = 4.0  # radius of a channel that leads to air inside


@dataclass(frozen=True, eq=False)
class GreyGrid:
    """Grey values (slices, rows, columns) of blocks of voxels, and their geometry."""

    values: NDArray[np.float32]
    geometry: VoxelGeometry

    @classmethod
    def of(cls, volume: Volume, spacing_mm: float, lowest_hu: float, highest_hu: float) -> GreyGrid:
        """Average blocks up to this spacing, of values clipped to a range."""
        geometry = volume.geometry
        blocks = np.maximum(1, np.floor(spacing_mm / geometry.spacing_mm + 1e-6)).astype(int)
        shape = np.array(geometry.shape) // blocks
        kept = tuple(slice(0, end) for end in (shape * blocks).tolist())
        (z, y, x), (i, j, k) = shape.tolist(), blocks.tolist()
        clipped = np.clip(volume.voxels[kept], np.int16(lowest_hu), np.int16(highest_hu))
        values = clipped.reshape(z, i, y, j, x, k).mean(axis=(1, 3, 5), dtype=np.float32)
        origin = geometry.to_patient_mm((blocks - 1) / 2.0)
        return cls(values, VoxelGeometry((z, y, x), origin, geometry.axes, geometry.spacing_mm * blocks))


@dataclass(frozen=True, eq=False)
class Body:
    """Boundary of the largest body: places (n, 3) mm and outward directions (n, 3)."""

    places_mm: Array
    outwards: Array
    volume_cm3: float


def find_body(grid: GreyGrid, threshold: float) -> Body | None:
    """Find the largest body above a threshold, None if there is none."""
    spacing = grid.geometry.spacing_mm
    solid = np.pad(grid.values > threshold, 1)
    core = ndimage.distance_transform_edt(solid, sampling=spacing) > THIN_MM
    labels, count = ndimage.label(core)
    if not count:
        return None
    body = _grow(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()), solid, spacing, REGROWN_MM)
    away = ndimage.distance_transform_edt(~body, sampling=spacing)
    wide, _ = ndimage.label(away > CHANNEL_MM)
    outer = (
        ndimage.distance_transform_edt(wide != wide[0, 0, 0], sampling=spacing) < CHANNEL_MM + spacing.max()
    )
    rim = body & ndimage.binary_dilation(outer & ~body)
    smooth = ndimage.gaussian_filter(body.astype(np.float32), THIN_MM / spacing)
    rows = tuple(np.argwhere(rim).T)
    slope = np.column_stack([np.gradient(smooth, axis=axis)[rows] / spacing[axis] for axis in range(3)])
    outwards = grid.geometry.directions_to_patient(-slope)
    length = np.linalg.norm(outwards, axis=1)
    kept = length > 0.0
    voxel_cm3 = float(np.prod(spacing)) / 1000.0
    return Body(
        grid.geometry.to_patient_mm(np.argwhere(rim)[kept] - 1),
        outwards[kept] / length[kept, None],
        float(body.sum()) * voxel_cm3,
    )


def _grow(core: Mask, solid: Mask, spacing: Array, reach_mm: float) -> Mask:
    """Return the solid that is within reach of the core and connected to it."""
    near = solid & (ndimage.distance_transform_edt(~core, sampling=spacing) < reach_mm)
    labels, _ = ndimage.label(near)
    touched = np.unique(labels[core])
    return np.asarray(np.isin(labels, touched[touched > 0]))
