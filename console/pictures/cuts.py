"""Flat images through a CT, along the patient's axes or along a trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.imaging.volume import Volume
from procedures.strategies.trajectory import Point

Array = NDArray[np.float64]

SIZE_PX = 400  # of an image, which is square
UNSCANNED_HU = -32768  # no CT has this value
UNSCANNED_GREY = 40  # unlike the black of air
ALIGNED = 1e-6  # of a voxel per pixel: below this an image stays in one slice
PNG_LEVEL = 0  # the network is this computer, and compression takes longer than everything else

WINDOWS_HU = {
    "spheres": (-1000.0, 600.0),
    "soft tissue": (-160.0, 240.0),
    "brain": (0.0, 80.0),
    "bone": (-500.0, 2000.0),
    "everything": (-1024.0, 3071.0),
}


class Plane(StrEnum):
    """Plane of an image."""

    AXIAL = "axial"
    CORONAL = "coronal"
    SAGITTAL = "sagittal"
    ALONG = "along"


# To the right and down in the image, LPS: as seen from the feet, from the front, from the left.
DIRECTIONS: dict[Plane, tuple[Point, Point]] = {
    Plane.AXIAL: ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    Plane.CORONAL: ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    Plane.SAGITTAL: ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
}


@dataclass(frozen=True, eq=False)
class Cut:
    """Pose of an image: its centre, its directions to the right and down, LPS; `step_mm` per pixel."""

    middle_mm: Array
    right: Array
    down: Array
    step_mm: float

    @cached_property
    def normal(self) -> Array:
        """Into the image."""
        return np.asarray(np.cross(self.right, self.down))

    def to_patient_mm(self, x_px: float, y_px: float) -> Point:
        """The position of a point in the image; (0, 0) is the corner of its first pixel."""
        half = SIZE_PX / 2.0
        place = self.middle_mm + self.step_mm * ((x_px - half) * self.right + (y_px - half) * self.down)
        return point(place)

    def to_picture(self, place_mm: ArrayLike) -> tuple[float, float, float]:
        """Image position of a point, px, and its distance behind the image, mm."""
        away = np.asarray(place_mm, dtype=float) - self.middle_mm
        half = SIZE_PX / 2.0
        return (
            half + float(away @ self.right) / self.step_mm,
            half + float(away @ self.down) / self.step_mm,
            float(away @ self.normal),
        )


def point(place: ArrayLike) -> Point:
    """Three plain numbers."""
    x, y, z = (float(value) for value in np.asarray(place))
    return x, y, z


def cut_png(volume: Volume, cut: Cut, window_hu: tuple[float, float]) -> bytes:
    """The image, black at the lower end of the window and white at the upper."""
    low, high = window_hu
    hu = cut_hu(volume, cut)
    grey = cv2.convertScaleAbs(np.clip(hu, low, high) - np.float32(low), alpha=255.0 / (high - low))
    grey[hu == UNSCANNED_HU] = UNSCANNED_GREY
    _, encoded = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    return bytes(encoded)


def cut_hu(volume: Volume, cut: Cut) -> NDArray[np.int16]:
    """HU of every pixel (rows, columns), interpolated within a slice; along a trajectory also between."""
    geometry = volume.geometry
    first = geometry.to_index(np.array(cut.to_patient_mm(0.5, 0.5)))
    per_px = (
        cut.step_mm * np.stack([cut.right @ geometry.axes, cut.down @ geometry.axes]) / geometry.spacing_mm
    )
    across = np.flatnonzero(np.abs(per_px).max(axis=0) * SIZE_PX < ALIGNED)
    if len(across) != 1:
        return _between_slices(volume, first, per_px)
    (axis,) = across
    number = round(float(first[axis]))
    if not 0 <= number < volume.voxels.shape[axis]:
        return np.full((SIZE_PX, SIZE_PX), UNSCANNED_HU, np.int16)
    row, column = (one for one in range(3) if one != axis)
    mapping = np.array(
        [
            [per_px[0, column], per_px[1, column], first[column]],
            [per_px[0, row], per_px[1, row], first[row]],
        ]
    )
    return np.asarray(
        cv2.warpAffine(
            np.ascontiguousarray(np.take(volume.voxels, number, axis=axis)),
            mapping,
            (SIZE_PX, SIZE_PX),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=UNSCANNED_HU,
        ),
        dtype=np.int16,
    )


def _between_slices(volume: Volume, first: Array, per_px: Array) -> NDArray[np.int16]:
    from scipy import ndimage

    matrix = np.stack([per_px[1], per_px[0], np.zeros(3)], axis=1)
    hu = ndimage.affine_transform(
        volume.voxels,
        matrix,
        offset=first,
        output_shape=(SIZE_PX, SIZE_PX, 1),
        order=1,
        mode="constant",
        cval=UNSCANNED_HU,
        prefilter=False,
    )
    return np.asarray(hu[..., 0])
