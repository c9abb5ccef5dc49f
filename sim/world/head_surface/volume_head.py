"""Head of a CT that a user brings: its skin by grey values, between the voxels.

The skin is where the trilinear grey value is halfway between air and soft tissue. Bodies apart from the head,
such as headrest and tubes, are taken for air.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim.errors import BAD_SCENE
from sim.world.head_surface.blending import Values
from sim.world.head_surface.distance_grid import DistanceGrid
from sim.world.head_surface.surface import march
from sim.world.rigid import Array, Vectors, as_point

if TYPE_CHECKING:
    from pydicom import Dataset

AIR_HU, SKIN_LEVEL_HU = -1000.0, -480.0  # halfway to skin of 40 HU
NEAR_MM = 2.0  # of the skin: grey values tell no greater distance
COARSE_MM = (
    7.0  # of the coarse distances: further out they alone count, and at ears they miss some millimetres
)
LEAST_SLOPE_HU_MM = 50.0
MASK_MM = 2.0  # spacing of the voxels by which bodies are told apart
ROOM_MM = 12.0
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # rows and columns of straight slices
TURNED = 1e-4  # of a direction's component
UNEVEN_MM = 0.02  # between the spacings of slices


@dataclass(frozen=True, eq=False)
class CtImage:
    """Grey values (x, y, z) in HU with the place of the first voxel, along the axes of the CT frame."""

    hu: NDArray[np.float32]
    first_mm: Array
    spacing_mm: Array

    def covers(self, points_mm: Vectors) -> NDArray[np.bool_]:
        """Return whether points (n,) are within the image."""
        place = (points_mm - self.first_mm) / self.spacing_mm
        return np.asarray(((place >= 0.0) & (place <= np.array(self.hu.shape) - 1)).all(axis=1))

    def at(self, points_mm: Vectors) -> Array:
        """Return trilinear values (n,); outside the image those of its border."""
        shape = np.array(self.hu.shape)
        place = np.clip((points_mm - self.first_mm) / self.spacing_mm, 0.0, shape - 1.000001)
        low = place.astype(np.intp)
        x, y, z = (place - low).T
        i, j, k = low.T
        lines = [
            self.hu[i + di, j + dj, k] * (1.0 - z) + self.hu[i + di, j + dj, k + 1] * z
            for di, dj in ((0, 0), (0, 1), (1, 0), (1, 1))
        ]
        near, far = (lines[n] * (1.0 - y) + lines[n + 1] * y for n in (0, 2))
        return np.asarray(near * (1.0 - x) + far * x)


class VolumeHead:
    """Skin of the largest body of a CT."""

    def __init__(self, image: CtImage) -> None:
        self._image, self._body = _largest_body(image)

    @property
    def extent_mm(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates of the body, to the voxel of its mask."""
        mask, spacing = self._body
        places = np.argwhere(mask)
        return self._image.first_mm + places.min(0) * spacing, self._image.first_mm + places.max(0) * spacing

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        points = np.asarray(points_mm, dtype=float).reshape(-1, 3)
        slope = np.linalg.norm(self._gradient(points), axis=1)
        near = (SKIN_LEVEL_HU - self._image.at(points)) / np.maximum(slope, LEAST_SLOPE_HU_MM)
        far = self.grid.at(points)
        is_near = (np.abs(far) < COARSE_MM) & self._image.covers(points)
        return np.asarray(np.where(is_near, np.clip(near, -NEAR_MM, NEAR_MM), far))

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        gradient = -self._gradient(np.asarray(points_mm, dtype=float).reshape(-1, 3))
        return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9))

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        # The coarse distances are those of whole voxels of the mask.
        voxel_mm = float(self._body[1].max())
        start, end = self.grid.approach(origins_mm, directions, furthest_mm, voxel_mm)
        return march(self.distance_mm, origins_mm, directions, end, start)

    @cached_property
    def grid(self) -> DistanceGrid:
        """Coarse distances from the body, over the image and a little beyond."""
        from scipy.ndimage import distance_transform_edt

        image, (mask, spacing) = self._image, self._body
        outside, inside = (distance_transform_edt(one, sampling=spacing) for one in (~mask, mask))
        signed = (outside - inside).astype(np.float32)

        def sample(x: Values, y: Values, z: Values) -> Values:
            places, beyond = [], []
            for value, first, step, count in zip((x, y, z), image.first_mm, spacing, mask.shape, strict=True):
                place = (value - first) / step
                held = np.clip(np.rint(place), 0, count - 1)
                places.append(held.astype(np.intp))
                beyond.append(np.abs(place - held) * step)
            away = np.sqrt(sum(one * one for one in beyond))
            held_mm = signed[tuple(np.broadcast_arrays(*places))]
            # The body ends where the image does.
            return np.asarray(np.where(away > 0.0, np.maximum(held_mm, 0.0) + away, held_mm))

        last = image.first_mm + (np.array(image.hu.shape) - 1) * image.spacing_mm
        return DistanceGrid.sample(sample, as_point(image.first_mm - ROOM_MM), as_point(last + ROOM_MM))

    def _gradient(self, points: Vectors) -> Vectors:
        steps = 0.5 * np.diag(self._image.spacing_mm)
        rises = [self._image.at(points + step) - self._image.at(points - step) for step in steps]
        return np.asarray(np.column_stack(rises) / self._image.spacing_mm)


def read_head(folder: Path) -> VolumeHead:
    """Read the skin of a CT series of straight slices; raises SIM-001 if there is none."""
    return VolumeHead(read_image(folder))


def list_slices(folder: Path) -> list[tuple[Path, Dataset]]:
    """Read the slices of a CT series with their files, from the feet upwards; raises SIM-001."""
    import pydicom
    from pydicom.errors import InvalidDicomError

    found = []
    for path in sorted(one for one in folder.iterdir() if one.is_file()) if folder.is_dir() else ():
        try:
            found.append((path, pydicom.dcmread(path)))
        except InvalidDicomError:
            continue
    if len(found) < 2:
        raise BAD_SCENE(f"{folder.name} holds no CT series", expected="at least two DICOM slices")
    if len({str(one.SeriesInstanceUID) for _, one in found}) > 1:
        raise BAD_SCENE(f"{folder.name} holds several series", expected="the slices of one")
    return sorted(found, key=lambda one: float(one[1].ImagePositionPatient[2]))


def read_image(folder: Path) -> CtImage:
    """Read a CT series of straight, evenly spaced slices; raises SIM-001 if there is none."""
    slices = [one for _, one in list_slices(folder)]
    if any(
        np.abs(np.array(one.ImageOrientationPatient, dtype=float) - UPRIGHT).max() > TURNED for one in slices
    ):
        raise BAD_SCENE(f"the slices of {folder.name} are tilted or turned", expected="straight axial slices")
    heights = np.array([float(one.ImagePositionPatient[2]) for one in slices])
    steps = np.diff(heights)
    if steps.min() <= 0.0 or np.ptp(steps) > UNEVEN_MM:
        raise BAD_SCENE(
            f"the slices of {folder.name} are not evenly spaced", got=f"{steps.min():g} to {steps.max():g} mm"
        )
    hu = np.stack([one.pixel_array * float(one.RescaleSlope) + float(one.RescaleIntercept) for one in slices])
    rows_mm, columns_mm = (float(one) for one in slices[0].PixelSpacing)
    return CtImage(
        np.ascontiguousarray(hu.transpose(2, 1, 0), dtype=np.float32),
        np.array([float(one) for one in slices[0].ImagePositionPatient]),
        np.array([columns_mm, rows_mm, float(steps.mean())]),
    )


def _largest_body(image: CtImage) -> tuple[CtImage, tuple[NDArray[np.bool_], Array]]:
    """Return the image with air around its largest body, and that body as a coarser mask."""
    from scipy.ndimage import binary_dilation, label

    strides = np.maximum(np.rint(MASK_MM / image.spacing_mm), 1).astype(int)
    solid = image.hu[tuple(slice(None, None, stride) for stride in strides)] > SKIN_LEVEL_HU
    bodies, count = label(solid)
    if not count:
        raise BAD_SCENE("the CT shows nothing but air")
    body = bodies == 1 + int(np.argmax(np.bincount(bodies.ravel())[1:]))
    around = binary_dilation(body, iterations=2)
    rows = [
        np.minimum(np.rint(np.arange(size) / stride).astype(int), coarse - 1)
        for size, stride, coarse in zip(image.hu.shape, strides, body.shape, strict=True)
    ]
    hu = np.where(around[np.ix_(*rows)], image.hu, np.float32(AIR_HU))
    return CtImage(hu, image.first_mm, image.spacing_mm), (body, strides * image.spacing_mm)
