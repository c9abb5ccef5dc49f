"""The slices of a scan as produced by its scanner, including faults."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from math import ceil, cos, radians, sin
from typing import Any

import numpy as np

from sim.phantom.head.layers import AIR_HU
from sim.phantom.head.shapes import Values
from sim.phantom.scan import Scan
from sim.phantom.scanner.beam_hardening import hardening
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.slice_painter import SlicePainter
from sim.world.noise import noise

WIDE_STORED, USUAL_STORED = 65535, 4095  # largest stored value


class Planes:
    """Paints any slice; `paint_patches` must come first. Slices do not depend on painting order."""

    def __init__(self, scan: Scan) -> None:
        faults, grid = scan.faults, scan.grid
        self._scan, self._grid = scan, grid
        self._tilt_rad = radians(faults.tilt_deg)
        self._span = ceil(grid.rows * grid.pixel_mm * abs(sin(self._tilt_rad)) / (2.0 * grid.slice_mm)) + 1
        if not self._tilt_rad:
            self._span = 0
        fed = replace(
            grid,
            slice_mm=grid.slice_mm * (1.0 + faults.table_scale),
            origin_mm=(*grid.origin_mm[:2], grid.origin_mm[2] - self._span * grid.slice_mm),
            slices=grid.slices + 2 * self._span,
        )
        self.moved_from, self.moved_by_mm = _motion(scan, fed)
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
        """Largest value that the scanner stores."""
        return WIDE_STORED if self._scan.faults.extended_range else USUAL_STORED

    def active(self) -> dict[str, Any]:
        """The faults for the truth file; empty if there are none."""
        faults = self._scan.faults.active()
        if self.moved_from:
            faults |= {"moved_from_slice": self.moved_from, "moved_by_mm": list(self.moved_by_mm)}
        return {"scanner": faults} if faults else {}

    def paint_patches(self, pool: Executor, progress: Callable[[int], None] = lambda done: None) -> None:
        """Paint what must be exact; `progress` is called with the number done."""
        done = 0
        for painter in self._painters:
            patches = []
            for patch in pool.map(painter.paint_patch, range(len(self._scan.anatomy.places))):
                patches.append(patch)
                done += 1
                progress(done)
            painter.patches = tuple(patches)

    def paint(self, number: int) -> Values:
        """HU (rows, columns) of one slice with its noise."""
        image = self._tilted(number) if self._tilt_rad else self._clean(number)
        image += self._before.noise(number)
        return image

    @property
    def _painters(self) -> tuple[SlicePainter, ...]:
        return (self._before,) if self._after is self._before else (self._before, self._after)

    def _clean(self, number: int) -> Values:
        painter = self._before if number < self.moved_from else self._after
        image = painter.clean(number)
        if self._scan.faults.beam_hardening:
            image += hardening(image, self._grid.pixel_mm, self._scan.faults.beam_hardening)
        return image

    def _tilted(self, number: int) -> Values:
        """A slice through straight ones, which are `_span` further down, tilted about its middle row."""
        grid = self._grid
        image = np.empty((grid.rows, grid.columns), dtype=np.float32)
        middle = 0.5 * (grid.rows - 1)
        for row in range(grid.rows):
            off = row - middle
            height = number + self._span + off * grid.pixel_mm * sin(self._tilt_rad) / grid.slice_mm
            line = middle + off * cos(self._tilt_rad)
            image[row] = self._between(height, line)
        return image

    def _between(self, height: float, line: float) -> Values:
        below, first = int(height), int(line)
        up, on = np.float32(height - below), np.float32(line - first)
        rows = [
            (1 - on) * plane[first] + on * plane[min(first + 1, len(plane) - 1)]
            for plane in (self._kept(below), self._kept(below + 1))
        ]
        between: Values = (1 - up) * rows[0] + up * rows[1]
        return between

    def _kept(self, number: int) -> Values:
        if not 0 <= number < self._grid.slices + 2 * self._span:
            return np.full((self._grid.rows, self._grid.columns), AIR_HU, dtype=np.float32)
        plane = self._straight.get(number)
        if plane is None:
            plane = self._straight[number] = self._clean(number)
            while len(self._straight) > 2 * self._span + 4:
                self._straight.popitem(last=False)
        return plane


def _motion(scan: Scan, grid: CtGrid) -> tuple[int, tuple[float, float, float]]:
    """The first slice after the patient has moved, halfway up the markers, and the displacement."""
    faults = scan.faults
    if not faults.motion_mm and not faults.slide_mm:
        return 0, (0.0, 0.0, 0.0)
    way = noise(scan.scene.seed, "patient moves", 0).standard_normal(3)
    x, y, z = (faults.motion_mm * way / np.linalg.norm(way)).tolist()
    middle_mm = float(np.median([fiducial.centre_ct_mm[2] for fiducial in scan.scene.head.fiducials]))
    return int(np.searchsorted(grid.z_mm, middle_mm)), (x, y, z + faults.slide_mm)
