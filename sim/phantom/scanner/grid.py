"""Voxel grid of a scan, placed to include all markers and trajectories.

CT frame: DICOM LPS, mm. Columns run along x, rows along y, slices along z; coordinates are voxel centres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.errors import BAD_SCENE
from sim.world.rigid import Point, Vector
from sim.world.scene.model import CtProtocol, Head, Scene
from sim.world.scene.skin import head_extent

MARKER_ROOM_MM = 14.0  # around a sphere's centre: the sphere, its blur, and air for contrast
TARGET_ROOM_MM = 3.0
ORIGIN_DIGITS = 4  # the grid is exactly what the headers can express

WHOLE_MM = (6.3, 9.0)  # from the highest sphere's centre to the end of the field: the sphere is whole
CUT_MM = (1.5, 4.5)  # from the leftmost sphere's centre: part of it is missing


@dataclass(frozen=True)
class CtGrid:
    """Voxel grid, with `origin_mm` (x, y, z) at the centre of the first voxel of the first slice."""

    origin_mm: tuple[float, float, float]
    pixel_mm: float
    slice_mm: float
    columns: int
    rows: int
    slices: int

    @property
    def x_mm(self) -> Vector:
        """Column centres in mm."""
        return _positions(self.origin_mm[0], self.pixel_mm, self.columns)

    @property
    def y_mm(self) -> Vector:
        """Row centres in mm."""
        return _positions(self.origin_mm[1], self.pixel_mm, self.rows)

    @property
    def z_mm(self) -> Vector:
        """Slice positions in mm."""
        return _positions(self.origin_mm[2], self.slice_mm, self.slices)

    def without_lowest(self, slices: int) -> CtGrid:
        """Return the grid without so many slices from the feet on."""
        x, y, z = self.origin_mm
        z = round(z + slices * self.slice_mm, ORIGIN_DIGITS)
        return replace(self, origin_mm=(x, y, z), slices=self.slices - slices)

    def indices(self, axis: int, low_mm: float, high_mm: float) -> slice:
        """Return the indices of voxels along `axis` (0, 1, 2) with centres between two coordinates."""
        spacing = self.slice_mm if axis == 2 else self.pixel_mm
        count = (self.columns, self.rows, self.slices)[axis]
        first = int(np.ceil((low_mm - self.origin_mm[axis]) / spacing))
        last = int(np.floor((high_mm - self.origin_mm[axis]) / spacing))
        return slice(min(max(first, 0), count), min(max(last + 1, 0), count))


def place_grid(head: Head, protocol: CtProtocol) -> CtGrid:
    """Return a grid centred on the patient, shifted only as required to include markers and trajectories.

    Raises SIM-001 when they do not fit into the protocol's field.
    """
    counts = np.array([protocol.columns, protocol.rows, protocol.slices])
    spacing = np.array([protocol.pixel_mm, protocol.pixel_mm, protocol.slice_mm])
    spheres = np.array([fiducial.centre_ct_mm for fiducial in head.fiducials]).reshape(-1, 3)
    ends = np.array([end for target in head.targets for end in (target.entry_ct_mm, target.target_ct_mm)])
    needed = np.vstack(
        [spheres - MARKER_ROOM_MM, spheres + MARKER_ROOM_MM, ends - TARGET_ROOM_MM, ends + TARGET_ROOM_MM]
    )
    low, high = needed.min(axis=0), needed.max(axis=0)
    field = counts * spacing
    if (high - low > field).any():
        raise BAD_SCENE(
            "markers and trajectories do not fit in the CT's field of view",
            expected=f"a field of {_format_dimensions(high - low)} mm",
            got=f"{_format_dimensions(field)} mm",
        )
    lowest, highest = head_extent(head)
    middle = 0.5 * (np.minimum(low, lowest) + np.maximum(high, highest))
    return centre_grid(np.clip(middle, high - field / 2, low + field / 2), protocol)


def shown_mm(scene: Scene, place_mm: Point) -> list[float]:
    """Return where a scene's series shows a place of the head, and the reverse.

    A mirrored series shows it on the other side of the middle of the field.
    """
    x, y, z = place_mm
    if scene.ct.mirrored:
        across_mm = place_grid(scene.head, scene.ct).x_mm
        x = float(across_mm[0] + across_mm[-1]) - x
    return [x, y, z]


def centre_grid(middle_mm: Vector, protocol: CtProtocol) -> CtGrid:
    """Return the grid of the protocol's field of view, centred on a point."""
    counts = np.array([protocol.columns, protocol.rows, protocol.slices])
    spacing = np.array([protocol.pixel_mm, protocol.pixel_mm, protocol.slice_mm])
    x, y, z = (round(float(value), ORIGIN_DIGITS) for value in middle_mm - (counts - 1) * spacing / 2)
    return CtGrid(
        (x, y, z), protocol.pixel_mm, protocol.slice_mm, protocol.columns, protocol.rows, protocol.slices
    )


def grid_ending_at_spheres(
    grid: CtGrid, head: Head, generator: np.random.Generator
) -> tuple[CtGrid, dict[int, float]]:
    """Shift the grid so that it ends close to one sphere and cuts another sphere.

    Returns it, and for each cut sphere the share of its surface that remains.
    """
    high_mm, left_mm = float(generator.uniform(*WHOLE_MM)), float(generator.uniform(*CUT_MM))
    spheres = sorted(head.fiducials, key=lambda fiducial: fiducial.centre_ct_mm[2])
    leftmost = max(head.fiducials, key=lambda fiducial: fiducial.centre_ct_mm[0])
    top_mm = spheres[-1].centre_ct_mm[2] + high_mm
    x_mm = leftmost.centre_ct_mm[0] + left_mm
    x, y, z = grid.origin_mm
    x += x_mm - (grid.x_mm[-1] + 0.5 * grid.pixel_mm)
    z += top_mm - (grid.z_mm[-1] + 0.5 * grid.slice_mm)
    origin = (round(float(x), ORIGIN_DIGITS), y, round(float(z), ORIGIN_DIGITS))
    shares = {}
    for fiducial in head.fiducials:
        centre, radius = fiducial.centre_ct_mm, fiducial.radius_mm
        cut_height_mm = max(centre[0] + radius - x_mm, centre[2] + radius - top_mm, 0.0)
        if cut_height_mm > 0.0:
            shares[fiducial.number] = round(
                1.0 - cut_height_mm / (2.0 * radius), 3
            )  # of a cap, by its height
    return replace(grid, origin_mm=origin), shares


def _positions(first_mm: float, spacing_mm: float, count: int) -> Vector:
    return first_mm + spacing_mm * np.arange(count, dtype=np.float64)


def _format_dimensions(values: Vector) -> str:
    return " x ".join(f"{value:.0f}" for value in values)
