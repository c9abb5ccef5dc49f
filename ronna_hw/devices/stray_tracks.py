"""Identity of stray markers from frame to frame: which reading is the same sphere as before.

A tracker reports strays in no fixed order: spheres change places in the list from one frame to the next. A
standard deviation taken by place in the list is the distance between spheres, not the noise of one.

Readings are assigned to the last known positions of the spheres so that the sum of distances is least, within
a gate. An identity is never carried on by a guess. It ends where

- readings and known spheres could be paired in more than one way within the gate, as when two spheres meet;
- most spheres lose their reading at once: tracker or head was moved between two frames;
- a sphere was hidden while the others moved.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ronna_hw.devices.errors import BadStrays
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.devices.strays import require_positions
from ronna_hw.vectors import Vector3

Array = NDArray[np.float64]

# Spheres of 11.5 mm that touch are 11.5 mm apart: at rest, a reading has a single sphere within this. At 60
# frames in a second it follows a motion of 300 mm/s.
GATE_MM = 5.0
UNKNOWN = -1  # identity of a reading that may belong to more than one sphere


@dataclass(frozen=True)
class StrayTrack:
    """One stray sphere in the frames in which it was seen, in tracker coordinates."""

    identity: int  # from 0, in the order of first appearance
    device_clock: NDArray[np.int64]  # (n,) the tracker's own count of frames
    positions_mm: Array  # (n, 3)


@dataclass
class _Sphere:
    last_mm: Array
    identity: int | None  # None while it cannot be told from another
    drift_mm: Array = field(default_factory=lambda: np.zeros(3))  # of the others since it was last seen


def track_strays(frames: Iterable[TrackerFrame], *, gate_mm: float = GATE_MM) -> tuple[StrayTrack, ...]:
    """Follow each stray sphere through the frames, whatever its place in their lists.

    Left out are repeated measurements (STALE), positions outside the measuring volume, and readings that may
    belong to more than one sphere. `gate_mm` is the farthest that a sphere may move between two frames.
    Raises DEV-005.
    """
    read = [frame for frame in frames if frame.validity is not Validity.STALE]
    kept = [[one.position_mm for one in frame.strays if one.validity is Validity.OK] for frame in read]
    seen: dict[int, list[tuple[int, Vector3]]] = {}
    for frame, positions, identities in zip(read, kept, identify_strays(kept, gate_mm=gate_mm), strict=True):
        for identity, position_mm in zip(identities.tolist(), positions, strict=True):
            seen.setdefault(identity, []).append((frame.stamp.device_clock, position_mm))
    seen.pop(UNKNOWN, None)
    return tuple(
        StrayTrack(
            identity,
            np.array([clock for clock, _ in readings], dtype=np.int64),
            np.array([position_mm for _, position_mm in readings], dtype=float),
        )
        for identity, readings in sorted(seen.items())
    )


def identify_strays(
    frames: Iterable[Sequence[Vector3]], *, gate_mm: float = GATE_MM
) -> tuple[NDArray[np.int64], ...]:
    """Return the identity of each stray position (mm), frame by frame, or -1 where it cannot be told.

    Raises DEV-005.
    """
    if not 0.0 < gate_mm < math.inf:
        raise BadStrays("the gate must be positive", got=f"{gate_mm} mm")
    spheres: list[_Sphere] = []
    expected, begun = 0, 0  # spheres in the last frame with any; identities so far
    found = []
    for frame in frames:
        readings = require_positions(frame)
        distances_mm = cdist(readings, _stack([one.last_mm for one in spheres]))
        pairs = _assign(distances_mm, gate_mm)
        if 2 * len(pairs) <= min(expected, len(readings)):  # the whole scene has moved
            spheres, pairs, distances_mm = [], {}, np.zeros((len(readings), 0))
        within = distances_mm <= gate_mm
        moved_mm = _stack([readings[row] - spheres[column].last_mm for row, column in pairs.items()])
        identities = np.full(len(readings), UNKNOWN, dtype=np.int64)
        here = []
        for row, reading in enumerate(readings):
            column = pairs.get(row)
            is_unclear = within[row].any() and (
                column is None or within[row].sum() + within[:, column].sum() > 2
            )
            identity = None if is_unclear or column is None else spheres[column].identity
            if identity is None and not is_unclear:
                identity, begun = begun, begun + 1
            identities[row] = UNKNOWN if identity is None else identity
            here.append(_Sphere(reading, identity))
        unseen = [one for column, one in enumerate(spheres) if not within[:, column].any()]
        if len(moved_mm):
            for one in unseen:
                one.drift_mm = one.drift_mm + np.median(moved_mm, axis=0)
        spheres = here + [one for one in unseen if float(np.linalg.norm(one.drift_mm)) <= gate_mm / 2.0]
        expected = len(readings) or expected
        found.append(identities)
    return tuple(found)


def _stack(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=float).reshape(-1, 3)


def _assign(distances_mm: Array, gate_mm: float) -> dict[int, int]:
    """Return the sphere for each reading that has one within the gate, with the least sum of distances."""
    out_of_gate_mm = 1e3 * gate_mm  # so costly that as many as possible are assigned within the gate
    rows, columns = linear_sum_assignment(np.where(distances_mm <= gate_mm, distances_mm, out_of_gate_mm))
    return {
        row: column
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if distances_mm[row, column] <= gate_mm
    }
