"""Coarse places of a truncated scan in a CT, by correlation of their bone at many turns.

The middle of a truncated skull is not that of the whole, so no start can be derived from it. For each turn
all shifts are tried at once by a Fourier transform.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.imaging.volume import OUTSIDE_FIELD_HU, Volume
from procedures.postoperative.bone_registration import BoneLevel, build_bone_level
from ronna_hw.arrays import Array

STEP_MM = 8.0
TURNS_RAD = np.radians((-24.0, -12.0, 0.0, 12.0, 24.0))  # of the head against the CT, about each axis
HALF_SIDE_MM = 132.0  # of the cube around the middle of each scan: a head with some air
MOST_STARTS = 6


def list_starts(ct: Volume, scan: Volume) -> list[RigidTransform]:
    """Return the likeliest poses CT <- scan, the best first, each of another turn."""
    middle, there = _middle(scan), _middle(ct)
    steps = np.arange(-HALF_SIDE_MM, HALF_SIDE_MM, STEP_MM)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    of_ct, of_scan = build_bone_level(ct, STEP_MM), build_bone_level(scan, STEP_MM)
    shape = [fft.next_fast_len(2 * len(steps), real=True)] * 3
    spectrum = fft.rfftn(_sample(of_ct, grid + there), s=shape)
    rated = []
    for turns in product(TURNS_RAD, repeat=3):
        rotation = Rotation.from_rotvec(turns)
        places = rotation.inv().apply(grid.reshape(-1, 3)).reshape(grid.shape) + middle
        values = _sample(of_scan, places)
        seen = _is_scanned(scan, places)
        pattern = np.where(seen, values - values[seen].mean(), 0.0)
        match = fft.irfftn(spectrum * np.conj(fft.rfftn(pattern, s=shape)), s=shape)
        best = np.unravel_index(int(match.argmax()), match.shape)
        shift = np.array(
            [(one + size // 2) % size - size // 2 for one, size in zip(best, shape, strict=True)]
        )
        moved = there + STEP_MM * shift
        pose = RigidTransform.from_components(moved - rotation.apply(middle), rotation)
        rated.append((float(match[best]) / float(np.linalg.norm(pattern)), pose))
    rated.sort(key=lambda one: -one[0])
    return [pose for _, pose in rated[:MOST_STARTS]]


def _middle(volume: Volume) -> Array:
    return np.asarray(volume.geometry.to_patient_mm((np.array(volume.geometry.shape) - 1.0) / 2.0))


def _sample(level: BoneLevel, places_mm: Array) -> NDArray[np.float32]:
    """Sample a level at the nearest voxel; no bone outside."""
    index = np.rint(level.geometry.to_index(places_mm)).astype(int)
    inside = ((index >= 0) & (index < level.geometry.shape)).all(axis=-1)
    index[~inside] = 0
    return np.where(inside, level.values[tuple(np.moveaxis(index, -1, 0))], np.float32(0.0))


def _is_scanned(volume: Volume, places_mm: Array) -> NDArray[np.bool_]:
    index = np.rint(volume.geometry.to_index(places_mm)).astype(int)
    inside = ((index >= 0) & (index < volume.geometry.shape)).all(axis=-1)
    index[~inside] = 0
    return np.asarray(inside & (volume.voxels[tuple(np.moveaxis(index, -1, 0))] > OUTSIDE_FIELD_HU))
