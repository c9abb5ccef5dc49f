"""A CT scan: contents, voxel grid, and slices as produced by a scanner with faults."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from math import ceil, cos, exp, radians, sin, sqrt
from typing import Any

import numpy as np

from sim.phantom.head.adhesive import skin_rings
from sim.phantom.head.anatomy import AIR_HU, Anatomy, draw_anatomy
from sim.phantom.head.faced_layers import layers_of
from sim.phantom.head.obstacles import (
    ADHESIVE,
    FREE,
    SKIN_ONLY,
    WITH_SKIN,
    XFRAME,
    frame_markers,
    frame_shapes,
)
from sim.phantom.head.painting import add_band, add_filling_streaks, add_streak, edge_sigma_mm, paint
from sim.phantom.head.shapes import Values
from sim.phantom.scanner.dicom_series import LARGEST_STORED
from sim.phantom.scanner.faults import KERNELS, NO_FAULTS, Kernel, ScannerFaults, hardening
from sim.phantom.scanner.fine_painting import Patch, paint_patch
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.phantom.scanner.metal_artefacts import MetalArtefacts, metal_parts
from sim.phantom.scanner.stretched_image import cut_stretched, slices_beyond
from sim.world.noise import noise
from sim.world.scene.model import Scene

RAMP_WIDTH = sqrt(12.0)  # of a linear edge with the variance of the scanner's
SKIN_MARGIN_MM = 3.0

WIDE_STORED = 65535  # largest value of 16 bits


@dataclass(frozen=True)
class Scan:
    """Scan contents, with `truth` for the truth file and `marks` (by number) for its fiducials."""

    scene: Scene
    grid: CtGrid
    anatomy: Anatomy
    fiducials: str = FREE
    truth: dict[str, Any] = field(default_factory=dict)
    marks: dict[int, dict[str, Any]] = field(default_factory=dict)
    faults: ScannerFaults = NO_FAULTS


def plain_scan(scene: Scene) -> Scan:
    """Return the scan of an unmodified scene; raises SIM-001 if it cannot be scanned."""
    whole, head = place_grid(scene.head, scene.ct), scene.head
    grid = whole.without_lowest(scene.ct.missing_slices)
    if not head.x_frame:
        kind = FREE if head.face is None else SKIN_ONLY if not head.fiducials else WITH_SKIN
        return Scan(scene, grid, with_rings(draw_anatomy(scene), scene), kind)
    generator = noise(scene.seed, "ct frame", 0)
    bare = draw_anatomy(scene.model_copy(update={"head": head.model_copy(update={"fiducials": ()})}))
    anatomy = replace(
        bare,
        surroundings=(*bare.surroundings, *frame_shapes(head, XFRAME, generator)),
        markers=frame_markers(head, generator),
    )
    return Scan(scene, grid, with_rings(anatomy, scene), XFRAME)


def adhesive_scan(scene: Scene) -> Scan:
    """Return the scan of a head with its adhesive markers alone, before any screw; raises SIM-001."""
    anatomy = with_rings(draw_anatomy(scene), scene)
    return Scan(scene, place_grid(scene.head, scene.ct), replace(anatomy, markers=()), ADHESIVE)


def with_rings(anatomy: Anatomy, scene: Scene) -> Anatomy:
    """Add the scene's adhesive rings, painted as finely as markers."""
    if not scene.head.adhesives:
        return anatomy
    return replace(
        anatomy,
        surroundings=(*anatomy.surroundings, *skin_rings(scene)),
        deceiving=(*anatomy.deceiving, *(one.centre_ct_mm for one in scene.head.adhesives)),
    )


class Planes:
    """Paints slices in any order, including scanner faults, once `paint_patches` has been called."""

    def __init__(self, scan: Scan) -> None:
        faults, grid = scan.faults, scan.grid
        self._scan, self._grid = scan, grid
        self._tilt_rad = radians(faults.tilt_deg)
        self._span = ceil(grid.rows * grid.pixel_mm * abs(sin(self._tilt_rad)) / (2.0 * grid.slice_mm)) + 1
        if not self._tilt_rad:
            self._span = slices_beyond(grid, faults.stretch)
        fed = replace(
            grid,
            slice_mm=grid.slice_mm * (1.0 + faults.table_scale),
            origin_mm=(*grid.origin_mm[:2], grid.origin_mm[2] - self._span * grid.slice_mm),
            slices=grid.slices + 2 * self._span,
        )
        self.moved_from, self.moved_by_mm = _draw_motion(scan, fed)
        x, y, z = fed.origin_mm
        dx, dy, dz = self.moved_by_mm
        self._before = SlicePainter(scan.scene, fed, scan.anatomy, faults)
        self._after = self._before
        if self.moved_from:
            moved = replace(fed, origin_mm=(x - dx, y - dy, z - dz))
            self._after = SlicePainter(scan.scene, moved, scan.anatomy, faults)
        self._straight: OrderedDict[int, Values] = OrderedDict()

    @property
    def steps(self) -> int:
        """Number of patches to paint."""
        return len(self._scan.anatomy.places) * len(self._painters)

    @property
    def largest_stored(self) -> int:
        """Largest value the scanner can store."""
        return WIDE_STORED if self._scan.faults.extended_range else LARGEST_STORED

    def active(self) -> dict[str, Any]:
        """Return the faults for the truth file, or an empty mapping if there are none."""
        faults = self._scan.faults.active()
        if self.moved_from:
            faults |= {"moved_from_slice": self.moved_from, "moved_by_mm": list(self.moved_by_mm)}
        return {"scanner": faults} if faults else {}

    def streaks_HU(self) -> list[float]:
        """Return the rms metal artefact inside each marker, once all slices are painted."""
        return self._before.streaks_HU()

    def paint_patches(self, pool: Executor, progress: Callable[[int], None] = lambda done: None) -> None:
        """Paint the regions that must be exact, calling `progress` with the number done."""
        done = 0
        for painter in self._painters:
            patches = []
            for patch in pool.map(painter.paint_patch, range(len(self._scan.anatomy.places))):
                patches.append(patch)
                done += 1
                progress(done)
            painter.patches = tuple(patches)

    def paint(self, number: int) -> Values:
        """Paint one slice in HU (rows, columns), including noise."""
        if self._tilt_rad:
            image = self._paint_tilted(number)
        elif (faults := self._scan.faults).stretch:
            image = cut_stretched(
                self._grid,
                faults.stretch,
                faults.stretch_along,
                number,
                lambda plane: self._paint_straight_plane(plane + self._span),
            )
        else:
            image = self._paint_clean(number)
        image += self._before.noise(number)
        return image

    @property
    def _painters(self) -> tuple[SlicePainter, ...]:
        return (self._before,) if self._after is self._before else (self._before, self._after)

    def _paint_clean(self, number: int) -> Values:
        painter = self._before if number < self.moved_from else self._after
        image = painter.clean(number)
        if self._scan.faults.beam_hardening:
            image += hardening(image, self._grid.pixel_mm, self._scan.faults.beam_hardening)
        return image

    def _paint_tilted(self, number: int) -> Values:
        """Cut a slice, tilted about its middle row, through straight slices starting `_span` further down."""
        grid = self._grid
        image = np.empty((grid.rows, grid.columns), dtype=np.float32)
        middle = 0.5 * (grid.rows - 1)
        for row in range(grid.rows):
            rows_off_middle = row - middle
            height = (
                number + self._span + rows_off_middle * grid.pixel_mm * sin(self._tilt_rad) / grid.slice_mm
            )
            line = middle + rows_off_middle * cos(self._tilt_rad)
            image[row] = self._interpolate_row(height, line)
        return image

    def _interpolate_row(self, height: float, line: float) -> Values:
        below, first = int(height), int(line)
        up, on = np.float32(height - below), np.float32(line - first)
        rows = [
            (1 - on) * plane[first] + on * plane[min(first + 1, len(plane) - 1)]
            for plane in (self._paint_straight_plane(below), self._paint_straight_plane(below + 1))
        ]
        row: Values = (1 - up) * rows[0] + up * rows[1]
        return row

    def _paint_straight_plane(self, number: int) -> Values:
        if not 0 <= number < self._grid.slices + 2 * self._span:
            return np.full((self._grid.rows, self._grid.columns), AIR_HU, dtype=np.float32)
        plane = self._straight.get(number)
        if plane is None:
            plane = self._straight[number] = self._paint_clean(number)
            while len(self._straight) > 2 * self._span + 4:
                self._straight.popitem(last=False)
        return plane


def _draw_motion(scan: Scan, grid: CtGrid) -> tuple[int, tuple[float, float, float]]:
    """Draw patient motion: the first slice after it, halfway up the markers, and the displacement."""
    faults = scan.faults
    if not faults.motion_mm and not faults.slide_mm:
        return 0, (0.0, 0.0, 0.0)
    direction = noise(scan.scene.seed, "patient moves", 0).standard_normal(3)
    x, y, z = (faults.motion_mm * direction / np.linalg.norm(direction)).tolist()
    head = scan.scene.head
    heights_mm = [fiducial.centre_ct_mm[2] for fiducial in head.fiducials] or [head.centre_ct_mm[2]]
    middle_mm = float(np.median(heights_mm))
    return int(np.searchsorted(grid.z_mm, middle_mm)), (x, y, z + faults.slide_mm)


class SlicePainter:
    """Paints straight slices in any order: head, bodies, marker patches, metal streaks and noise."""

    def __init__(
        self, scene: Scene, grid: CtGrid, anatomy: Anatomy, faults: ScannerFaults = NO_FAULTS
    ) -> None:
        head = scene.head
        self._scene = scene
        self._grid = grid
        self._anatomy = anatomy
        self._kernel = KERNELS[faults.kernel]
        self._thickness_mm = faults.thickness_mm or grid.slice_mm
        edge_mm = edge_sigma_mm(grid.pixel_mm, self._thickness_mm, self._kernel.plane_sigma_mm)
        self._edge_mm = RAMP_WIDTH * edge_mm
        self._head = layers_of(head, edge_mm)
        self._sharp_head = layers_of(head, 0.0)
        self._x, self._y = grid.x_mm.astype(np.float32), grid.y_mm.astype(np.float32)
        self._z_mm = grid.z_mm
        self._background = self._paint_background()
        self._bodies = []  # with the lowest and highest z at which each is visible
        for shape in anatomy.shapes:
            if shape not in anatomy.headrest:
                (_, _, low), (_, _, high) = shape.bounds()
                self._bodies.append((low - 0.5 * self._edge_mm, high + 0.5 * self._edge_mm, shape))
        self.patches: tuple[Patch, ...] = ()
        self._metal = None
        if faults.metal_artefacts:
            self._metal = MetalArtefacts(
                metal_parts(anatomy),
                anatomy.places,
                grid,
                self._kernel,
                self._thickness_mm,
                scene.ct.noise_HU,
            )

    def paint_patch(self, number: int) -> Patch:
        """Paint the surroundings of a centre; complete all `patches` before painting slices."""
        return paint_patch(
            self._anatomy.places[number],
            self._anatomy.shapes,
            self._sharp_head,
            self._grid,
            self._kernel,
            self._thickness_mm,
        )

    def clean(self, number: int) -> Values:
        """Paint one slice in HU (rows, columns), without noise."""
        z_mm = float(self._z_mm[number])
        z = np.array([z_mm], dtype=np.float32)
        image = self._background.copy()
        self._paint_head(image, z_mm)
        for low_mm, high_mm, shape in self._bodies:
            if low_mm <= z_mm <= high_mm:
                paint(image[None], (self._x, self._y, z), shape, self._edge_mm)
        for patch in self.patches:
            if patch.slices.start <= number < patch.slices.stop:
                image[patch.rows, patch.columns] = patch.hu[number - patch.slices.start]
        if self._metal is None:
            for filling in self._anatomy.fillings:
                add_filling_streaks(image, self._x, self._y, z_mm, filling)
            for streak in self._anatomy.streaks:
                add_streak(image, self._x, self._y, z_mm, streak)
        for band in self._anatomy.bands:
            add_band(image, self._x, self._y, z_mm, band)
        if self._metal is not None:
            self._metal.add(image, number, noise(self._scene.seed, "ct metal", number))
        return image

    def streaks_HU(self) -> list[float]:
        """Return the rms artefact inside each marker, once all slices are painted; none without artefacts."""
        return [] if self._metal is None else self._metal.strengths_HU()[: len(self._anatomy.markers)]

    def _paint_background(self) -> Values:
        """Paint the air and headrest shared by all slices."""
        image = np.full((1, len(self._y), len(self._x)), AIR_HU, dtype=np.float32)
        somewhere = self._z_mm[:1].astype(np.float32)
        for shape in self._anatomy.headrest:
            paint(image, (self._x, self._y, somewhere), shape, self._edge_mm)
        background: Values = image[0]
        return background

    def _paint_head(self, image: Values, z_mm: float) -> None:
        half_widths = self._head.half_widths(z_mm, SKIN_MARGIN_MM)
        if half_widths is None:
            return
        (cx, cy, _), (half_x, half_y) = self._head.centre, half_widths
        columns = self._grid.indices(0, cx - half_x, cx + half_x)
        rows = self._grid.indices(1, cy - half_y, cy + half_y)
        x, y = self._x[None, columns], self._y[rows, None]
        region = image[rows, columns]
        # anything next to the head is denser than the air in the corners of this rectangle
        np.maximum(region, self._head.hu_at(x, y, np.full((1, 1), z_mm, dtype=np.float32)), out=region)

    def noise(self, number: int) -> Values:
        """Draw the noise for one slice."""
        generator = noise(self._scene.seed, "ct", number)
        shape = (len(self._y), len(self._x))
        return slice_noise(generator, shape, self._grid.pixel_mm, self._scene.ct.noise_HU, self._kernel)


def slice_noise(
    generator: np.random.Generator,
    shape: tuple[int, ...],
    pixel_mm: float,
    noise_HU: float,
    kernel: Kernel = KERNELS["standard"],
) -> Values:
    """Draw noise (rows, columns), correlated within the slice by the kernel."""
    rows, columns = shape
    white = generator.standard_normal((rows + 2, columns + 2), dtype=np.float32)
    blurred = exp(-0.5 * (pixel_mm / kernel.plane_sigma_mm) ** 2)
    side = np.float32(blurred if kernel.noise_side is None else kernel.noise_side)
    gain = 1.0 + 2.0 * float(side) ** 2  # of the variance, along each of both axes
    along = white[:-2] + white[2:]
    along *= side
    along += white[1:-1]
    smooth = along[:, :-2] + along[:, 2:]
    smooth *= side
    smooth += along[:, 1:-1]
    smooth *= np.float32(noise_HU / gain)
    return smooth
