"""CT volumes: voxels in HU, their geometry in patient coordinates, and regions cut from them.

Grid millimetres are voxel indices (slice, row, column) times their spacing: a Cartesian frame that differs
from the patient's only by rotation and translation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from procedures.imaging.errors import VOLUME_MALFORMED
from ronna_hw.arrays import Array, Mask
from ronna_hw.vectors import vector3

AXES_TOLERANCE = 1e-6  # on the scalar products of the axes

_LETTERS = (("R", "L"), ("A", "P"), ("I", "S"))  # negative and positive end of the LPS axes

AIR_HU = -1000.0
OUTSIDE_FIELD_HU = -1500  # scanners pad outside their round field with values far below air


@dataclass(frozen=True, eq=False)
class VoxelGeometry:
    """Voxel positions in patient coordinates (DICOM LPS, mm).

    Voxel indices are (slice, row, column); integers are voxel CENTRES, so the volume begins half a voxel
    before index 0. The columns of `axes` (3, 3) are the unit directions in which the slice, row and column
    index increase; they are orthonormal, right- or left-handed. `spacing_mm` has the same order. `origin_mm`
    is the centre of voxel (0, 0, 0). Raises CT-022 for anything else.
    """

    shape: tuple[int, int, int]
    origin_mm: Array
    axes: Array
    spacing_mm: Array

    def __post_init__(self) -> None:
        has_size = len(self.shape) == 3 and min(self.shape) > 0
        shapes = [np.shape(value) for value in (self.origin_mm, self.axes, self.spacing_mm)]
        if not has_size or shapes != [(3,), (3, 3), (3,)]:
            raise VOLUME_MALFORMED("the geometry has the wrong shape", got=f"{self.shape}, {shapes}")
        numbers = np.concatenate([self.origin_mm, np.ravel(self.axes), self.spacing_mm])
        if not np.isfinite(numbers).all() or np.min(self.spacing_mm) <= 0:
            raise VOLUME_MALFORMED("a geometry that is not finite, or a spacing that is not positive")
        if np.abs(self.axes.T @ self.axes - np.eye(3)).max() > AXES_TOLERANCE:
            raise VOLUME_MALFORMED("the axes are not perpendicular unit vectors")

    def to_patient_mm(self, indices: ArrayLike) -> Array:
        """Return the patient positions (..., 3) mm of voxel indices (..., 3), which may be fractional."""
        return self.origin_mm + self.directions_to_patient(np.asarray(indices, dtype=float) * self.spacing_mm)

    def to_index(self, points_mm: ArrayLike) -> Array:
        """Return the fractional voxel indices (..., 3) of patient positions (..., 3) mm."""
        offsets = np.asarray(points_mm, dtype=float) - self.origin_mm
        return np.asarray(offsets @ self.axes / self.spacing_mm)

    def contains(self, points_mm: ArrayLike) -> Mask:
        """Return whether patient positions (..., 3) mm are within the outer voxel faces."""
        index = self.to_index(points_mm)
        return np.asarray(((index >= -0.5) & (index <= np.array(self.shape) - 0.5)).all(axis=-1))

    @property
    def ends_mm(self) -> tuple[Array, Array]:
        """Least and largest L, P, S (3,) of the outer voxel faces, if tilted of the box around them."""
        corners = self.to_patient_mm(list(product(*((-0.5, size - 0.5) for size in self.shape))))
        return corners.min(axis=0), corners.max(axis=0)

    def grid_mm_to_patient_mm(self, points_mm: ArrayLike) -> Array:
        """Return the patient positions (..., 3) mm of grid positions (..., 3), index times spacing."""
        return self.origin_mm + self.directions_to_patient(points_mm)

    def directions_to_patient(self, vectors: ArrayLike) -> Array:
        """Rotate vectors (..., 3) from (slice, row, column) to the patient axes L, P, S."""
        return np.asarray(np.asarray(vectors, dtype=float) @ self.axes.T)

    def covariance_to_patient(self, covariance: ArrayLike) -> Array:
        """Rotate a covariance (3, 3) from (slice, row, column) to the patient axes L, P, S."""
        return np.asarray(self.axes @ np.asarray(covariance, dtype=float) @ self.axes.T)

    @property
    def orientation(self) -> str:
        """Patient sides towards which columns, rows and slices increase, e.g. `LPS`."""
        return "".join(_side_letter(self.axes[:, axis]) for axis in (2, 1, 0))


@dataclass(frozen=True, eq=False)
class Volume:
    """One CT series, or one to fuse with it, without patient identity.

    `voxels` is int16 HU, of another modality its stored values, shape (slices, rows, columns), read-only.
    `patient_position` is the scanner's code for the patient's position (`HFS` is head first, supine),
    `kernel` its name for the reconstruction kernel; both and the study's UID are empty if not stated.
    `warnings` are sentences for the user on limits of the accuracy. Raises CT-022 for other voxels.
    """

    voxels: NDArray[np.int16]
    geometry: VoxelGeometry
    series_instance_uid: str
    frame_of_reference_uid: str
    patient_position: str = ""
    kernel: str = ""
    warnings: tuple[str, ...] = ()
    study_instance_uid: str = ""

    def __post_init__(self) -> None:
        # integers: NaN cannot hide among the voxels
        if self.voxels.dtype != np.int16 or self.voxels.shape != self.geometry.shape:
            raise VOLUME_MALFORMED(
                f"voxels of {self.voxels.dtype} and shape {self.voxels.shape}",
                expected=f"int16 and {self.geometry.shape}",
            )

    @cached_property
    def extent_mm(self) -> Array:
        """Size along (slice, row, column) between the outer voxel faces, (3,) mm."""
        return np.asarray(self.geometry.spacing_mm * self.geometry.shape)

    def sample(self, places_mm: ArrayLike, outside_hu: float) -> NDArray[Any]:
        """Interpolate HU linearly, as float32, at patient positions (..., 3) mm; `outside_hu` elsewhere."""
        index = np.moveaxis(self.geometry.to_index(places_mm), -1, 0)
        sampled = map_coordinates(self.voxels, index, output=np.float32, order=1, cval=outside_hu)
        return np.asarray(sampled)

    def patient_mm(self, grid_mm: ArrayLike) -> tuple[float, float, float]:
        """Return the patient position (LPS) of a grid position (3,) mm."""
        return vector3(self.geometry.grid_mm_to_patient_mm(grid_mm))


@dataclass(frozen=True, eq=False)
class Region:
    """Cuboid of voxels (slices, rows, columns) in HU, NaN outside the scan; `start` is the first index."""

    values: Array
    start: NDArray[np.int64]
    spacing_mm: Array

    def axes_mm(self) -> tuple[Array, Array, Array]:
        """Return the grid positions of the voxel centres along each axis, broadcastable over `values`."""
        z, y, x = (
            (self.start[axis] + np.arange(self.values.shape[axis])) * self.spacing_mm[axis]
            for axis in range(3)
        )
        return z[:, None, None], y[None, :, None], x[None, None, :]

    def sample(self, points_mm: Array, *, smooth: bool = False) -> Array:
        """Interpolate HU at grid positions (..., 3) mm; NaN outside the region and next to unscanned voxels.

        Linear, or with `smooth` cubic splines: five times the work, but no bias between thick slices.
        """
        indices = np.moveaxis(points_mm / self.spacing_mm - self.start, -1, 0)
        if not smooth:
            return np.asarray(map_coordinates(self.values, indices, order=1, mode="constant", cval=np.nan))
        sampled = map_coordinates(self._spline, indices, order=3, mode="mirror", prefilter=False)
        if not self._is_complete or not self._contains(indices):
            known = map_coordinates(self.values, indices, order=1, mode="constant", cval=np.nan)
            sampled[~np.isfinite(known)] = np.nan
        return np.asarray(sampled)

    @cached_property
    def _is_complete(self) -> bool:
        return bool(np.isfinite(self.values).all())

    @cached_property
    def _spline(self) -> Array:
        filled = self.values if self._is_complete else np.nan_to_num(self.values, nan=AIR_HU)
        return np.asarray(spline_filter(filled, order=3, mode="mirror"))

    def _contains(self, indices: Array) -> bool:
        last = np.array(self.values.shape) - 1.0
        axes = tuple(range(1, indices.ndim))
        return bool((indices.min(axis=axes) >= 0).all() and (indices.max(axis=axes) <= last).all())


def cut_region(volume: Volume, centre_mm: Array, half_width_mm: float) -> Region:
    """Cut out the voxels within a cube around a grid position, clipped to the volume."""
    cube = cube_around(volume.geometry, centre_mm, half_width_mm)
    piece = volume.voxels[cube]
    values = piece.astype(float)
    values[piece < OUTSIDE_FIELD_HU] = np.nan
    start = np.array([part.start for part in cube], dtype=np.int64)
    return Region(values, start, volume.geometry.spacing_mm)


def cube_around(geometry: VoxelGeometry, centre_mm: Array, half_width_mm: float) -> tuple[slice, ...]:
    """Return the index ranges of a cube around a grid position, at least one voxel along each axis."""
    shape = np.array(geometry.shape)
    low = np.clip(np.floor((centre_mm - half_width_mm) / geometry.spacing_mm).astype(int), 0, shape - 1)
    high = np.ceil((centre_mm + half_width_mm) / geometry.spacing_mm).astype(int) + 1
    high = np.clip(high, low + 1, shape)
    return tuple(slice(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))


def _side_letter(direction: Array) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return _LETTERS[axis][int(direction[axis] > 0)]
