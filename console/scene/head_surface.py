"""Surface mesh of the head from its CT, small enough for any graphics hardware."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from console.scene.bodies import METRES
from procedures.imaging.drawn_skin import DrawnSkin
from procedures.imaging.series import read_series
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import parse_json, read_json_bytes

GRID_MM = 3.0  # finer detail is not visible next to the arm
SMOOTHING_VOXELS = 0.8  # otherwise the blocks show as terraces
SKIN_HU = -480.0  # halfway between air and skin
STL_HEAD_BYTES = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])


def find_series_folder(run: Path) -> Path | None:
    """Return the folder of a run's CT series: the run's copy, or the requested folder."""
    own = run / "case" / "ct"
    if own.is_dir():
        return own
    try:
        case = parse_json(read_json_bytes(run / "request.json")).get("case")
    except (OSError, ValueError, AttributeError):
        return None
    return Path(case) / "ct" if isinstance(case, str) else None


def build_head(series: Path) -> tuple[bytes, DrawnSkin]:
    """Build a binary STL in CT coordinates, metres, and the skin from three sides.

    Raises reading errors, and CT-022 without a head.
    """
    corners_mm, triangles = head_surface(read_series(series))
    return encode_stl(corners_mm, triangles), DrawnSkin(corners_mm, corner_normals(corners_mm, triangles))


def head_surface(volume: Volume) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices (n, 3) in LPS mm and triangles (m, 3) of the largest body denser than air, filled.

    Raises ValueError if there is none.
    """
    from scipy import ndimage
    from skimage.measure import marching_cubes

    factor = np.maximum(1, np.rint(GRID_MM / volume.geometry.spacing_mm)).astype(int)
    means = _block_means(volume.voxels, factor)
    smooth = ndimage.gaussian_filter(np.pad(means, 1, constant_values=-1000.0), SMOOTHING_VOXELS)
    labels, count = ndimage.label(smooth > SKIN_HU)
    if not count:
        raise ValueError("the CT contains only air")
    largest = labels == 1 + int(np.bincount(labels.ravel())[1:].argmax())
    solid = ndimage.binary_fill_holes(largest)
    smooth[solid & ~largest] = 0.0  # an internal hollow
    smooth[~ndimage.binary_dilation(solid)] = -1000.0  # anything else in the image
    corners, triangles, _, _ = marching_cubes(smooth, SKIN_HU)
    middle = (factor - 1) / 2.0  # of a block, in voxels
    return volume.geometry.to_patient_mm((corners - 1.0) * factor + middle), triangles.astype(np.int64)


def corner_normals(corners_mm: Array, triangles: NDArray[np.int64]) -> Array:
    """Return outward unit normals (n, 3) at the corners of a closed surface."""
    a, b, c = (corners_mm[triangles[:, corner]] for corner in range(3))
    facets = np.cross(b - a, c - a)
    normals = np.zeros_like(corners_mm)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], facets)
    outwards = np.sign(np.sum(facets * (a - corners_mm.mean(axis=0))))  # the volume enclosed
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(outwards * np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0))


def _block_means(voxels: NDArray[np.int16], factor: NDArray[np.int64]) -> Array:
    """Average over whole blocks, slab by slab, to avoid a full-size float copy of the volume."""
    counts = np.array(voxels.shape) // factor
    a, b, c = (int(count_per_axis) for count_per_axis in factor)
    slices, rows, columns = (int(count_per_axis) for count_per_axis in counts)
    means = np.empty((slices, rows, columns))
    for number in range(slices):
        slab = voxels[number * a : (number + 1) * a, : rows * b, : columns * c]
        means[number] = slab.reshape(a, rows, b, columns, c).mean(axis=(0, 2, 4))
    return means


def encode_stl(corners_mm: Array, triangles: NDArray[np.int64]) -> bytes:
    """Encode a surface as binary STL in metres."""
    facets = np.zeros(len(triangles), FACET)
    facets["corners"] = corners_mm[triangles] * METRES
    first, second, third = (facets["corners"][:, number] for number in range(3))
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return bytes(STL_HEAD_BYTES) + struct.pack("<I", len(facets)) + facets.tobytes()
