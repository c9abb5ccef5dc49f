"""Landmarks of a head in a CT: where it reaches furthest in a direction, thin parts such as ears included."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array

AIR_BELOW_HU = -300.0  # fat is about -100
AROUND_MM = 40.0  # of the furthest place of the skin, to each side: an ear stands out from it by less
INSIDE_MM = 4.0  # below the skin, where surely is tissue
TIP_MM = 1.0  # below its furthest place, which belongs to a landmark


def find_landmark(volume: Volume, skin_mm: Array, direction: tuple[float, float, float]) -> Array:
    """Return where a head reaches furthest in a direction, (3,) mm, near the furthest of its skin (n, 3).

    What is not joined to the head by tissue does not count, such as the shell of a headrest.
    """
    outwards = np.array(direction) / np.linalg.norm(direction)
    skin = _furthest(skin_mm, outwards)
    index = volume.geometry.to_index(skin[None])[0]
    half = np.ceil(AROUND_MM / volume.geometry.spacing_mm)
    low = np.maximum(0, np.floor(index - half)).astype(int)
    high = np.minimum(volume.geometry.shape, np.ceil(index + half) + 1).astype(int)
    tissue = volume.voxels[tuple(map(slice, low, high))] > AIR_BELOW_HU
    labels, _ = ndimage.label(tissue)
    inside = np.rint(volume.geometry.to_index((skin - INSIDE_MM * outwards)[None])[0]).astype(int) - low
    own = labels[tuple(np.clip(inside, 0, np.array(labels.shape) - 1))]
    if not own:
        return skin
    return _furthest(volume.geometry.to_patient_mm(np.argwhere(labels == own) + low), outwards)


def _furthest(places_mm: Array, outwards: Array) -> Array:
    along_mm = places_mm @ outwards
    return np.asarray(places_mm[along_mm > along_mm.max() - TIP_MM].mean(axis=0))
