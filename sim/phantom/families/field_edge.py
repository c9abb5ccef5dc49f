"""A scan field that ends close to one sphere and cuts another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.phantom.scanner.grid import ORIGIN_DIGITS, CtGrid
from sim.world.scene.model import Head

WHOLE_MM = (6.3, 9.0)  # from the highest sphere's centre to the end of the field: the sphere is whole
CUT_MM = (1.5, 4.5)  # from the leftmost sphere's centre: part of it is missing


def grid_ending_at_spheres(
    grid: CtGrid, head: Head, generator: np.random.Generator
) -> tuple[CtGrid, dict[int, float]]:
    """Shift the grid accordingly; returns which spheres are cut, and how much of their surface remains."""
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
        beyond = max(centre[0] + radius - x_mm, centre[2] + radius - top_mm, 0.0)
        if beyond > 0.0:
            shares[fiducial.number] = round(1.0 - beyond / (2.0 * radius), 3)  # of a cap, by its height
    return replace(grid, origin_mm=origin), shares
