"""The angle at which a planned trajectory meets the skull: a drill slips on bone at too shallow an angle.

Parallel rays around the trajectory find the outer surface of the bone; a plane through the points where they
meet it gives the surface's direction. Judged by HU alone.
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
OUTSIDE_MM, INSIDE_MM = 40.0, 40.0  # along the trajectory, about the entry: the range searched for bone
STEP_MM = 0.25
RINGS_MM = (2.0, 4.0)  # about the trajectory: the width of a burr hole
AROUND = 8
LEAST_RAYS = 9  # of 17 that must meet bone
NEAR_MM = 15.0  # along the trajectory, from where the central ray meets bone: farther off it is another bone


def skull_angle_rad(volume: Volume, trajectory: Trajectory) -> float | None:
    """Angle between a trajectory and the skull's outer surface, pi/2 if perpendicular; None without bone."""
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
    """Distance along the ray at which it meets bone, interpolated; NaN if it meets none."""
    last = np.array(volume.geometry.shape) - 0.5
    index = volume.geometry.to_index(places_mm)
    held = np.all((index > -0.5) & (index < last), axis=1)
    hu = sampled_hu(volume, places_mm[held])
    bone = np.flatnonzero(hu > BONE_HU)
    return float(steps_mm[held][bone[0]]) if len(bone) and len(hu) == held.sum() else float("nan")
