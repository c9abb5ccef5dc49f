"""One slice of the scan: head, bodies, marker patches, streaks of metal, noise."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from sim.phantom.head.anatomy import Anatomy
from sim.phantom.head.layers import AIR_HU, HeadLayers
from sim.phantom.head.shapes import Shape, Values
from sim.phantom.head.streaks import add_band, add_filling_streaks, add_streak
from sim.phantom.scanner import blur
from sim.phantom.scanner.faults import KERNELS, NO_FAULTS, Kernel, ScannerFaults
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.painting import paint
from sim.phantom.scanner.sphere_patch import Patch, paint_patch
from sim.world.noise import noise
from sim.world.scene.model import Scene

RAMP_WIDTH = sqrt(12.0)  # of a linear edge with the variance of the scanner's
SKIN_MARGIN_MM = 3.0


class SlicePainter:
    """Paints any slice of a scene; slices depend neither on each other nor on painting order."""

    def __init__(
        self, scene: Scene, grid: CtGrid, anatomy: Anatomy, faults: ScannerFaults = NO_FAULTS
    ) -> None:
        head = scene.head
        self._scene = scene
        self._grid = grid
        self._anatomy = anatomy
        self._kernel = KERNELS[faults.kernel]
        self._thickness_mm = faults.thickness_mm or grid.slice_mm
        edge_mm = blur.edge_sigma_mm(grid.pixel_mm, self._thickness_mm, self._kernel.plane_sigma_mm)
        self._edge_mm = RAMP_WIDTH * edge_mm
        self._head = HeadLayers(head.centre_ct_mm, head.semi_axes_mm, edge_mm)
        self._sharp_head = HeadLayers(head.centre_ct_mm, head.semi_axes_mm, 0.0)
        self._x, self._y = grid.x_mm.astype(np.float32), grid.y_mm.astype(np.float32)
        self._z_mm = grid.z_mm
        self._background = self._paint_background()
        self._bodies = [
            (*_heights(shape, 0.5 * self._edge_mm), shape)
            for shape in anatomy.shapes
            if shape not in anatomy.headrest
        ]
        self.patches: tuple[Patch, ...] = ()

    def paint_patch(self, number: int) -> Patch:
        """The surroundings of one of the places; `patches` must contain all of them
        before painting slices.
        """
        return paint_patch(
            self._anatomy.places[number],
            self._anatomy.shapes,
            self._sharp_head,
            self._grid,
            self._kernel,
            self._thickness_mm,
        )

    def paint(self, number: int) -> Values:
        """HU (rows, columns) of one slice with its noise."""
        image = self.clean(number)
        image += self.noise(number)
        return image

    def clean(self, number: int) -> Values:
        """HU (rows, columns) of one slice without noise."""
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
        for filling in self._anatomy.fillings:
            add_filling_streaks(image, self._x, self._y, z_mm, filling)
        for streak in self._anatomy.streaks:
            add_streak(image, self._x, self._y, z_mm, streak)
        for band in self._anatomy.bands:
            add_band(image, self._x, self._y, z_mm, band)
        return image

    def _paint_background(self) -> Values:
        """Air and headrest, the same in all slices."""
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
        np.maximum(region, self._head.at(x, y, np.full((1, 1), z_mm, dtype=np.float32)), out=region)

    def noise(self, number: int) -> Values:
        """Noise of one slice."""
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
    """Noise (rows, columns), correlated within the slice by the scanner's kernel."""
    rows, columns = shape
    white = generator.standard_normal((rows + 2, columns + 2), dtype=np.float32)
    blurred = exp(-0.5 * (pixel_mm / kernel.plane_sigma_mm) ** 2)
    side = np.float32(blurred if kernel.noise_side is None else kernel.noise_side)
    smooth = white[1:-1] + side * (white[:-2] + white[2:])
    smooth = smooth[:, 1:-1] + side * (smooth[:, :-2] + smooth[:, 2:])
    gain = 1.0 + 2.0 * float(side) ** 2  # of the variance, along each of both axes
    smooth *= np.float32(noise_HU / gain)
    return smooth


def _heights(shape: Shape, margin_mm: float) -> tuple[float, float]:
    """Lowest and highest z at which a body is visible."""
    (_, _, low), (_, _, high) = shape.bounds()
    return low - margin_mm, high + margin_mm
