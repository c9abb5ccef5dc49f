"""The head in the CT: its shape as an obstacle, entry path checks, and trajectory angles to the skull.

The shape is one ellipsoid around everything denser than air and thick enough. Thin objects (posts and cables,
the shell of a headrest, the tips of ears) are removed first, so that they do not inflate it.

A trajectory must lead from the air outside, through the skin, to a target inside. Swapped or foreign points
show up here, by HU alone: the target is in air, the line before the entry passes through the head, or most of
the path inside is air.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from procedures.planning.errors import NO_HEAD_IN_CT, NotIntoHead, StandoffInsideSkin
from procedures.planning.plan_model import PlannedTrajectory
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.frames import perpendicular_axes
from ronna_hw.vectors import vector3

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

AIR_BELOW_HU = -300.0  # fat is about -100, foam of a headrest about -930, air -1000
GRID_MM = 4.0  # a head is large: this resolution is enough
THIN_MM = 18.0  # anything thinner in any direction is not part of the head
LEAST_VOXELS = 500  # 32 ml: anything smaller is not a head
TARGET_BALL_MM = 3.0  # radius in which the target's surroundings are averaged
# Before the entry: beyond the scalp for an oblique trajectory, still near the head.
BEFORE_ENTRY_MM = (15.0, 25.0)
SAMPLING_MM = 1.0
LEAST_SHARE = 0.5  # "mostly": of the samples
SKIN_WITHIN_MM = 40.0  # outwards from an entry planned on the bone
AIR_RUN_MM = 5.0  # of the room outside: a fold of the skin is shorter
SKIN_RUN_MM = 5.0  # of the head: a cover on it is thinner
OFF_SKIN_MM = 10.0  # more than a coarse slice or thick hair
BONE_HU = 300.0  # brain and skin stay below 100, the outer face of the skull has 600 and more
# Along the trajectory, about the entry: the range searched for bone.
BONE_OUTSIDE_MM, BONE_INSIDE_MM = 40.0, 40.0
STEP_MM = 0.25
RINGS_MM = (2.0, 4.0)  # about the trajectory: the width of a burr hole
AROUND = 8  # points of a ring
LEAST_RAYS = 9  # of 17 that must meet bone
SAME_BONE_MM = 15.0  # along the trajectory, from where the central ray meets bone: farther is another bone


class HeadEllipsoid(Strict):
    """Ellipsoid around the head in CT coordinates."""

    centre_mm: Numbers3 = Field(description="Its centre, LPS.")
    semi_axes_mm: Numbers3 = Field(description="Semi-axes along left, posterior, superior.")

    def side_of(self, entry_mm: Numbers3, target_mm: Numbers3) -> str:
        """Return the side of a trajectory: `left`, `middle` or `right`, or such as `left to right`."""
        return " to ".join(dict.fromkeys(self._side(x) for x, *_ in (entry_mm, target_mm)))

    def half_of(self, entry_mm: Numbers3) -> str:
        """Return the half of the head with an entry: `front`, `middle` or `back`."""
        offset_mm = entry_mm[1] - self.centre_mm[1]
        if abs(offset_mm) < GRID_MM:
            return "middle"
        return "back" if offset_mm > 0.0 else "front"

    def _side(self, x_mm: float) -> str:
        offset_mm = x_mm - self.centre_mm[0]
        if abs(offset_mm) < GRID_MM:  # the head's middle is not known better
            return "middle"
        return "left" if offset_mm > 0.0 else "right"


def fit_head(volume: Volume) -> HeadEllipsoid:
    """Fit the smallest axis-aligned ellipsoid around the whole head. Raises PLAN-014.

    A head cut off by the CT is used as far as the CT shows it.
    """
    points, grid_mm = sample_head(volume)
    centre, semi = least_ellipsoid(points)
    # plus the grid step, and what opening rounds off
    return HeadEllipsoid(centre_mm=vector3(centre), semi_axes_mm=vector3(semi + grid_mm))


def sample_head(volume: Volume) -> tuple[Array, float]:
    """Return points (n, 3), LPS mm, that fill the head without its thin parts, and their spacing.

    Raises PLAN-014.
    """
    from scipy import ndimage

    strides = np.maximum(1, np.rint(GRID_MM / volume.geometry.spacing_mm)).astype(int)
    thinned = volume.voxels[tuple(slice(None, None, int(stride)) for stride in strides)]
    spacing_mm = volume.geometry.spacing_mm * strides
    solid = thinned > AIR_BELOW_HU
    rounds = max(1, round(THIN_MM / 2.0 / float(spacing_mm.mean())))
    # Filled first: air in sinuses and throat must not hollow it out.
    solid = ndimage.binary_fill_holes(solid)
    # The border counts as solid, so that a head cut off by the CT keeps its cut face.
    kept = ndimage.binary_erosion(solid, iterations=rounds, border_value=1)
    labels, count = ndimage.label(kept)
    sizes = np.bincount(labels.ravel())[1:] if count else np.zeros(1, dtype=int)
    if sizes.max() < LEAST_VOXELS:
        raise NO_HEAD_IN_CT("the CT shows nothing of the size of a head", got=f"{sizes.max()} solid cells")
    largest = labels == 1 + int(sizes.argmax())
    largest = ndimage.binary_dilation(largest, iterations=rounds)
    points = volume.geometry.to_patient_mm(np.argwhere(largest) * strides)
    return np.asarray(points), float(spacing_mm.max())


def least_ellipsoid(points_mm: Array) -> tuple[Array, Array]:
    """Return centre and semi-axes, (3,) each, of the smallest axis-aligned ellipsoid around points (n, 3).

    Convex in reciprocal axes and scaled centre: min -sum(log b) under |b p - d| <= 1 (Boyd & Vandenberghe,
    Convex Optimization, 8.4.1). Not simply the bounding box: half a head is not a small whole one.
    """
    from scipy.optimize import minimize
    from scipy.spatial import ConvexHull

    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    unit = (points_mm[ConvexHull(points_mm).vertices] - middle) / half  # each between -1 and 1

    def room(unknown: Array) -> Array:
        return np.asarray(1.0 - ((unknown[:3] * unit - unknown[3:]) ** 2).sum(axis=1))

    def slope(unknown: Array) -> Array:
        offset = unknown[:3] * unit - unknown[3:]
        return np.hstack([-2.0 * offset * unit, 2.0 * offset])

    found = minimize(
        lambda unknown: -np.log(unknown[:3]).sum(),
        np.r_[np.full(3, 1.0 / np.sqrt(3.0)), np.zeros(3)],  # the circumscribed ball contains them all
        jac=lambda unknown: np.r_[-1.0 / unknown[:3], np.zeros(3)],
        constraints={"type": "ineq", "fun": room, "jac": slope},
        bounds=[(0.1, 2.0)] * 3 + [(None, None)] * 3,
        method="SLSQP",
    )
    semi, centre = 1.0 / found.x[:3], found.x[3:] / found.x[:3]
    # scaled to contain all points exactly
    overshoot = float(np.linalg.norm((unit - centre) / semi, axis=1).max())
    return middle + half * centre, half * semi * overshoot


def check_entry_path(volume: Volume, trajectory: PlannedTrajectory) -> tuple[NotIntoHead | None, str]:
    """Check whether a trajectory leads into the head. Return any finding, and a warning or ''.

    Anything beyond the CT is unknown and refuses nothing; a line before the entry that is entirely outside it
    is a warning, as is an entry out in the air.
    """
    entry, target = np.array(trajectory.entry_mm), np.array(trajectory.target_mm)
    problems, is_unseen = find_entry_problems(volume, entry, target)
    warning = f"the CT ends before the entry of trajectory {trajectory.id}: its skin was not checked"
    if not problems:
        return None, _warn_far_from_skin(volume, trajectory) or (warning if is_unseen else "")
    swapped = not find_entry_problems(volume, target, entry)[0]
    hint = "; reversed, it would fit: entry and target are probably swapped" if swapped else ""
    return NotIntoHead(f"trajectory {trajectory.id}: {', '.join(problems)}{hint}"), ""


def find_entry_problems(volume: Volume, entry: Array, target: Array) -> tuple[list[str], bool]:
    """List problems of a trajectory, and return whether the path before its entry is outside the CT."""
    depth_mm = float(np.linalg.norm(target - entry))
    direction = (target - entry) / depth_mm
    problems = []
    around = float(sample_hu(volume, target + _ball_offsets()).mean())
    if around < AIR_BELOW_HU:
        problems.append(f"the target is in air ({around:.0f} HU)")
    before = sample_hu(volume, entry - np.outer(_steps(*BEFORE_ENTRY_MM), direction))
    if len(before) and float(np.mean(before < AIR_BELOW_HU)) < LEAST_SHARE:
        problems.append(
            f"the path {BEFORE_ENTRY_MM[0]:g} to {BEFORE_ENTRY_MM[1]:g} mm in front of the entry is not in "
            f"air ({np.median(before):.0f} HU)"
        )
    inside = sample_hu(volume, entry + np.outer(_steps(0.0, depth_mm), direction))
    in_air = float(np.mean(inside < AIR_BELOW_HU))
    if in_air > 1.0 - LEAST_SHARE:
        problems.append(f"{in_air:.0%} of the path from entry to target is in air")
    return problems, len(before) == 0


def _warn_far_from_skin(volume: Volume, trajectory: PlannedTrajectory) -> str:
    """Return a warning if the entry is more than `OFF_SKIN_MM` in front of the skin, otherwise ''."""
    steps = _steps(0.0, trajectory.depth_mm)
    places = np.array(trajectory.entry_mm) + np.outer(steps, trajectory.trajectory.axis_ct)
    off_mm = _first_run_mm(steps, sample_hu(volume, places) >= AIR_BELOW_HU, SKIN_RUN_MM)
    if off_mm is None or off_mm <= OFF_SKIN_MM:
        return ""
    return (
        f"the entry of trajectory {trajectory.id} is {off_mm:.0f} mm in front of the skin: "
        "depth and stand-off count from it"
    )


def check_standoff(
    volume: Volume, trajectory: PlannedTrajectory, standoff_mm: float
) -> StandoffInsideSkin | None:
    """Return a finding if this stand-off would place the guide's end inside the skin, otherwise None.

    Unknown if the CT ends before the skin does.
    """
    entry, target = np.array(trajectory.entry_mm), np.array(trajectory.target_mm)
    outwards = (entry - target) / np.linalg.norm(entry - target)
    steps = _steps(0.0, SKIN_WITHIN_MM)
    in_air = sample_hu(volume, entry + np.outer(steps, outwards)) < AIR_BELOW_HU
    skin_mm = max(0.0, (_first_run_mm(steps, in_air, AIR_RUN_MM) or 0.0) - SAMPLING_MM)
    if standoff_mm > skin_mm:
        return None
    return StandoffInsideSkin(
        f"trajectory {trajectory.id}: the guide would be held inside the skin",
        expected=f"standoff_mm of more than {skin_mm:.0f} mm in front of the entry",
        got=f"{standoff_mm:g} mm",
    )


def sample_hu(volume: Volume, points_mm: ArrayLike) -> Array:
    """Sample HU at points (n, 3) in LPS mm by nearest voxel, dropping points outside the CT."""
    index = np.rint(volume.geometry.to_index(points_mm)).astype(np.intp)
    mask = np.all((index >= 0) & (index < np.array(volume.geometry.shape)), axis=1)
    return np.asarray(volume.voxels[tuple(index[mask].T)], dtype=float)


def _steps(first_mm: float, last_mm: float) -> Array:
    return np.linspace(first_mm, last_mm, max(2, round((last_mm - first_mm) / SAMPLING_MM) + 1))


def _first_run_mm(steps_mm: Array, mask: Mask, length_mm: float) -> float | None:
    """Return the start in mm of the first run of at least this length, or None."""
    run = round(length_mm / SAMPLING_MM)
    return next((float(steps_mm[k]) for k in range(len(mask) - run + 1) if mask[k : k + run].all()), None)


def _ball_offsets() -> Array:
    steps = np.arange(-TARGET_BALL_MM, TARGET_BALL_MM + SAMPLING_MM / 2, SAMPLING_MM)
    offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return np.asarray(offsets[np.linalg.norm(offsets, axis=1) <= TARGET_BALL_MM])


def skull_angle_rad(volume: Volume, trajectory: Trajectory) -> float | None:
    """Return a trajectory's angle to the skull surface, pi/2 if perpendicular, or None without bone."""
    axis = np.asarray(trajectory.axis_ct, dtype=float)
    ring, across_axes = ring_around(axis)
    offsets = np.concatenate([np.zeros((1, 3)), *(radius * ring for radius in RINGS_MM)])
    steps = np.arange(-BONE_OUTSIDE_MM, min(BONE_INSIDE_MM, trajectory.depth_mm), STEP_MM)
    starts = np.asarray(trajectory.entry_mm) + offsets
    bone_mm = np.array([_first_bone_mm(volume, start + steps[:, None] * axis, steps) for start in starts])
    if np.isnan(bone_mm[0]):
        return None
    is_same_bone = np.abs(bone_mm - bone_mm[0]) < SAME_BONE_MM
    if is_same_bone.sum() < LEAST_RAYS:
        return None
    across = offsets[is_same_bone] @ np.stack(across_axes, axis=1)
    design = np.column_stack([across, np.ones(is_same_bone.sum())])
    slope = np.linalg.lstsq(design, bone_mm[is_same_bone], rcond=None)[0][:2]
    return float(np.pi / 2.0 - np.arctan(np.linalg.norm(slope)))


def ring_around(axis: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return a ring of unit vectors (AROUND, 3) about an axis, and the two axes across that span it."""
    side, other = perpendicular_axes(axis)
    turns = np.arange(AROUND) * 2.0 * np.pi / AROUND
    return np.outer(np.cos(turns), side) + np.outer(np.sin(turns), other), (side, other)


def _first_bone_mm(volume: Volume, places_mm: Array, steps_mm: Array) -> float:
    """Return the distance along a ray to the first bone in mm, or NaN without bone or outside the CT."""
    last = np.array(volume.geometry.shape) - 0.5
    index = volume.geometry.to_index(places_mm)
    mask = np.all((index > -0.5) & (index < last), axis=1)
    hu = sample_hu(volume, places_mm[mask])
    bone = np.flatnonzero(hu > BONE_HU)
    return float(steps_mm[mask][bone[0]]) if len(bone) and len(hu) == mask.sum() else float("nan")
