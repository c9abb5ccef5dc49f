"""At which angle a planned way meets the skull: a drill slips on bone that it meets too flat.

Rays beside the way and parallel to it find the outer face of the bone; a plane through where they meet it
gives the face's direction. Judged by HU alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from procedures.planning.head.tissue import sampled_hu
from procedures.strategies.trajectory import Trajectory

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

BONE_HU = 300.0  # brain and skin stay below 100, the outer face of the skull has 600 and more
OUTSIDE_MM, INSIDE_MM = 40.0, 40.0  # along the way, about the entry: where the bone is looked for
STEP_MM = 0.25
RINGS_MM = (2.0, 4.0)  # about the way: the width of a burr hole
AROUND = 8
LEAST_RAYS = 9  # of 17 that have to meet bone
NEAR_MM = 15.0  # along the way, of where the middle ray meets it: farther off it is another bone


def skull_angle_rad(volume: Volume, trajectory: Trajectory) -> float | None:
    """Between a way and the skull's outer face, pi/2 where it meets it straight; None without bone."""
    axis = np.asarray(trajectory.axis_ct, dtype=float)
    side = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    turns = np.arange(AROUND) * 2.0 * np.pi / AROUND
    ring = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), other)
    offsets = np.concatenate([np.zeros((1, 3)), *(radius * ring for radius in RINGS_MM)])
    steps = np.arange(-OUTSIDE_MM, min(INSIDE_MM, trajectory.depth_mm), STEP_MM)
    starts = np.asarray(trajectory.entry_mm) + offsets
    met = np.array([_first_bone_mm(volume, start + steps[:, None] * axis, steps) for start in starts])
    if np.isnan(met[0]):
        return None
    good = np.abs(met - met[0]) < NEAR_MM
    if good.sum() < LEAST_RAYS:
        return None
    across = offsets[good] @ np.stack([side, other], axis=1)
    design = np.column_stack([across, np.ones(good.sum())])
    slope = np.linalg.lstsq(design, met[good], rcond=None)[0][:2]
    return float(np.pi / 2.0 - np.arctan(np.linalg.norm(slope)))


def _first_bone_mm(volume: Volume, places_mm: Array, steps_mm: Array) -> float:
    """How far along it a ray meets bone, with a share of a step; not a number where it meets none."""
    last = np.array(volume.geometry.shape) - 0.5
    index = volume.geometry.to_index(places_mm)
    held = np.all((index > -0.5) & (index < last), axis=1)
    hu = sampled_hu(volume, places_mm[held])
    bone = np.flatnonzero(hu > BONE_HU)
    return float(steps_mm[held][bone[0]]) if len(bone) and len(hu) == held.sum() else float("nan")
