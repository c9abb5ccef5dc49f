"""Image region around a straight trajectory into the head, and quality of the fits made in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import perpendicular_axes

STEP_MM = 0.5  # of the coarse pass
SEARCH_MM = 10.0  # across the trajectory: nothing farther off is taken for the instrument
SLAB_MM = 1.0  # along the trajectory, for what is judged slab by slab

AT_BOUND = 1e-3  # of the range between the two bounds


@dataclass(frozen=True, eq=False)
class PlannedLine:
    """Straight line from `entry_mm` to `target_mm`, (3,) each, in patient coordinates."""

    entry_mm: Array
    target_mm: Array

    @property
    def length_mm(self) -> float:
        """Distance from entry to target."""
        return float(np.linalg.norm(self.target_mm - self.entry_mm))

    @property
    def inwards(self) -> Array:
        """Unit vector (3,) from entry to target."""
        return np.asarray((self.target_mm - self.entry_mm) / self.length_mm)

    @cached_property
    def axes(self) -> Array:
        """Unit vectors as columns: one along the trajectory, two across it."""
        return np.column_stack([self.inwards, *perpendicular_axes(self.inwards)])

    def apply_pose(self, pose: RigidTransform) -> PlannedLine:
        """Return the line moved by a pose."""
        return PlannedLine(pose.apply(self.entry_mm), pose.apply(self.target_mm))

    def to_patient_mm(self, local_mm: Array) -> Array:
        """Convert positions along and across the line, mm from the entry, to patient positions (..., 3)."""
        return np.asarray(self.entry_mm + local_mm @ self.axes.T)

    def to_local_mm(self, points_mm: Array) -> Array:
        """Convert patient positions (..., 3) to positions along and across the line, mm from the entry."""
        return np.asarray((points_mm - self.entry_mm) @ self.axes)


@dataclass(frozen=True, eq=False)
class ImagedSurroundings:
    """HU on a grid of `STEP_MM` around a trajectory (along, across, across), at positions (..., 3) mm.

    NaN outside the scan, where nothing is known.
    """

    values: Array
    places_mm: Array


def sample_along(volume: Volume, line: PlannedLine, first_mm: float, last_mm: float) -> ImagedSurroundings:
    """Sample HU by linear interpolation around a trajectory, between two distances from its entry."""
    side = np.arange(-SEARCH_MM, SEARCH_MM + STEP_MM / 2, STEP_MM)
    along = np.arange(first_mm, last_mm, STEP_MM)
    local = np.stack(np.meshgrid(along, side, side, indexing="ij"), axis=-1)
    return ImagedSurroundings(volume.sample(line.to_patient_mm(local), np.nan), local)


def select_voxels(
    volume: Volume, line: PlannedLine, between_mm: tuple[float, float], radius_mm: float
) -> tuple[Array, Array]:
    """Return HU and centres (n, 3) mm, along and across, of the voxels within a radius of a trajectory.

    The grid continues beyond the scan, with NaN.
    """
    geometry = volume.geometry
    ends = geometry.to_index(line.to_patient_mm(np.array([[one, 0.0, 0.0] for one in between_mm])))
    room = radius_mm / geometry.spacing_mm + 1.0
    low = np.floor(ends.min(axis=0) - room).astype(int)
    high = np.ceil(ends.max(axis=0) + room).astype(int) + 1
    index = np.indices(high - low).reshape(3, -1).T + low
    local = line.to_local_mm(geometry.to_patient_mm(index))
    near = (local[:, 0] >= between_mm[0]) & (local[:, 0] <= between_mm[1])
    near &= np.hypot(local[:, 1], local[:, 2]) <= radius_mm
    index = index[near]
    inside = np.all((index >= 0) & (index < np.array(geometry.shape)), axis=1)
    values = np.full(len(index), np.nan)
    values[inside] = volume.voxels[tuple(index[inside].T)]
    return local[near], values


@dataclass(frozen=True)
class FitQuality:
    """Quality of a fit. `whole` if the scan covers the region needed, `inside` if no bound was reached."""

    whole: bool
    ended: bool
    inside: bool
    residual_hu: float
    radius_mm: float

    @property
    def failures(self) -> tuple[str, ...]:
        """Reasons why the fit gives no position and direction."""
        expected = {
            "the CT ends there": self.whole,
            "the fit did not converge": self.ended,
            "position, direction or radius ended at a limit of the fit": self.inside,
        }
        return tuple(words for words, holds in expected.items() if not holds)


@dataclass(frozen=True, eq=False)
class FittedAxis:
    """Axis of an object: tip or point in the bone, (3,) mm, and the unit vector out of the head."""

    point_mm: Array
    outwards: Array
    quality: FitQuality


@dataclass(frozen=True)
class ExpectedFit:
    """Limits of plausible fits: the largest residual in HU, and the range of radii in mm."""

    residual_hu: float
    radius_mm: tuple[float, float]

    def doubts(self, quality: FitQuality) -> tuple[str, ...]:
        """List the reasons why a fitted position and direction may be wrong."""
        sentences = []
        if quality.residual_hu > self.residual_hu:
            usual = f"normally up to {self.residual_hu:g} HU"
            sentences.append(f"the residual of the fit is {quality.residual_hu:.0f} HU, {usual}")
        low_mm, high_mm = self.radius_mm
        if not low_mm <= quality.radius_mm <= high_mm:
            usual = f"{low_mm:g} to {high_mm:g} mm"
            sentences.append(f"its radius of {quality.radius_mm:.2f} mm is not within {usual}")
        return tuple(sentences)


def mark_at_bound(found: Array, low: Array, high: Array) -> Mask:
    """Flag the fitted parameters (n,) that reached a bound."""
    close = AT_BOUND * (high - low)
    return np.asarray((found - low < close) | (high - found < close))
