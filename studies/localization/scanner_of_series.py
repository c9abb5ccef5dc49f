"""Properties of the scanner that made a series, measured in it: blur, noise, and the skin in air.

A series that cannot carry inserted markers is refused: no head, too few slices, or no air around the head.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from procedures.imaging import Volume
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import robust_sigma
from studies.errors import SERIES_WITHOUT_ROOM, SERIES_WITHOUT_SCALE

SKIN_HU = -300.0  # between fat and what hair, foam or a sheet show
AIR_HU, OPEN_AIR_HU = -1000.0, -850.0
SOFT_HU = (-20.0, 80.0)  # brain and muscle, where noise is measured
SOFT_DEPTH_MM = 4.0  # from anything else
LEAST_HEAD_ML = 300.0
LEAST_SOFT_VOXELS = 2000
LEAST_SLICES, LEAST_LENGTH_MM = 24, 40.0  # a marker with its base is 24 mm long
LARGEST_SPACING_MM = (3.0, 1.5)  # between slices, and of pixels: a ball is 11.5 mm
EDGES, EDGE_MM, EDGE_STEP_MM = 400, 8.0, 0.25  # profiles across the skin, their half length
STEP_HU = 700.0  # between air and skin, at least
SHARP_EDGES_PERCENTILE = 20.0  # the skin is rarely cut at right angles and never quite smooth
ROOT_TWO_PI = float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class SeriesScanner:
    """A series with its spacing (slice, row, column), the head in it, blur in the slice, and noise in tissue.

    `blur_mm` is the standard deviation of the reconstruction's point spread with the pixel.
    """

    volume: Volume
    head: Mask
    blur_mm: float
    noise_hu: float

    @property
    def spacing_mm(self) -> Array:
        return self.volume.geometry.spacing_mm

    @cached_property
    def skin_distance_mm(self) -> Array:
        """Distance of every voxel outside the head from it, in mm."""
        outside: Array = ndimage.distance_transform_edt(~self.head, sampling=self.spacing_mm)
        return outside

    @cached_property
    def is_open_air(self) -> Mask:
        return np.asarray(self.volume.voxels < OPEN_AIR_HU)


def measure_scanner(volume: Volume) -> SeriesScanner:
    """Measure a series. Raises STU-027 if its voxels are too few, STU-028 if no head stands in air."""
    spacing = volume.geometry.spacing_mm
    slices = volume.voxels.shape[0]
    pixel_mm = float(spacing[1:].max())
    if slices < LEAST_SLICES or slices * spacing[0] < LEAST_LENGTH_MM:
        raise SERIES_WITHOUT_SCALE(
            "the series has too few slices",
            expected=f"at least {LEAST_SLICES} over {LEAST_LENGTH_MM:g} mm",
            got=f"{slices} over {slices * spacing[0]:.0f} mm",
        )
    if spacing[0] > LARGEST_SPACING_MM[0] or pixel_mm > LARGEST_SPACING_MM[1]:
        raise SERIES_WITHOUT_SCALE(
            "the voxels are too large",
            expected="slices of at most {:g} mm, pixels of at most {:g} mm".format(*LARGEST_SPACING_MM),
            got=f"{spacing[0]:.2f} and {pixel_mm:.2f} mm",
        )
    head = find_head(volume)
    return SeriesScanner(volume, head, _measure_blur_mm(volume, head), _measure_noise_hu(volume, head))


def find_head(volume: Volume) -> Mask:
    """Mark the head: the largest body denser than air, with its cavities filled slice by slice."""
    labels, _ = ndimage.label(ndimage.binary_opening(volume.voxels > SKIN_HU, iterations=2))
    sizes = np.bincount(labels.ravel())[1:]
    millilitres = 1e-3 * float(sizes.max(initial=0) * np.prod(volume.geometry.spacing_mm))
    if millilitres < LEAST_HEAD_ML:
        raise SERIES_WITHOUT_ROOM("no head in the series", got=f"{millilitres:.0f} ml of one solid body")
    head = labels == 1 + int(sizes.argmax())
    return np.array([ndimage.binary_fill_holes(one) for one in head])


def _measure_noise_hu(volume: Volume, head: Mask) -> float:
    """Return the standard deviation in soft tissue, from neighbours in a row two slices apart."""
    smooth = ndimage.uniform_filter(volume.voxels.astype(np.float32), 3)
    soft = head & (smooth > SOFT_HU[0]) & (smooth < SOFT_HU[1])
    rounds = np.maximum(1, np.rint(SOFT_DEPTH_MM / volume.geometry.spacing_mm)).astype(int)
    soft = ndimage.minimum_filter(soft, 2 * rounds + 1)
    pairs = soft[2:] & soft[:-2]
    if int(pairs.sum()) < LEAST_SOFT_VOXELS:
        raise SERIES_WITHOUT_ROOM(
            "no soft tissue in which noise can be measured",
            expected=f"at least {LEAST_SOFT_VOXELS} voxels",
            got=f"{int(pairs.sum())}",
        )
    differences = volume.voxels[2:].astype(float)[pairs] - volume.voxels[:-2].astype(float)[pairs]
    return robust_sigma(differences) / float(np.sqrt(2.0))


def _measure_blur_mm(volume: Volume, head: Mask) -> float:
    """Return the blur of the sharpest profiles across the skin, within slices: step over steepest slope."""
    spacing = volume.geometry.spacing_mm
    skin = np.argwhere(head & ~ndimage.binary_erosion(head))
    skin = skin[:: max(1, len(skin) // (8 * EDGES))]
    depth = ndimage.gaussian_filter(head.astype(np.float32), 3.0 / spacing)
    slopes = np.stack([np.gradient(depth, axis=axis) for axis in (1, 2)], axis=-1)[tuple(skin.T)]
    outwards = -slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-9)
    along = np.arange(-EDGE_MM, EDGE_MM, EDGE_STEP_MM)
    places = skin[:, None, 1:] + outwards[:, None] * along[:, None] / spacing[1:]
    rows = np.repeat(skin[:, :1].astype(float), len(along), axis=1)
    profiles = ndimage.map_coordinates(
        volume.voxels, np.stack([rows, places[..., 0], places[..., 1]]), float, order=3, mode="nearest"
    )
    inside, outside = (np.median(one, axis=1) for one in (profiles[:, :12], profiles[:, -12:]))
    step = inside - outside
    clear = (outside < OPEN_AIR_HU) & (step > STEP_HU)
    if int(clear.sum()) < EDGES:
        raise SERIES_WITHOUT_ROOM(
            "too little skin borders on air",
            expected=f"at least {EDGES} profiles from air into the head",
            got=f"{int(clear.sum())}",
        )
    steepest = -np.gradient(profiles[clear], EDGE_STEP_MM, axis=1).min(axis=1)
    return float(np.percentile(step[clear] / steepest, SHARP_EDGES_PERCENTILE)) / ROOT_TWO_PI
