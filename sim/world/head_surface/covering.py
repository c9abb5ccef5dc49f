"""Ellipsoids around a head with a face, as a planner takes it for an obstacle.

One is around the cranium, down to where it is widest, and one around what is below it, as far as a CT shows.
Both are the smallest along the axes, so over forehead and temples they reach up to a centimetre outside.
NumPy alone: drawing a scene must not load SciPy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.surface import march
from sim.world.rigid import Array, Point, Vectors, as_point

# A planner divides a head and measures its size so (`procedures.planning.faced_head`), and its ellipsoids are
# foreseen; it does not share the code, as it knows the skin from a CT alone.
CRANIUM_MM = 90.0  # from the vertex down, of a usual head
MEASURED_MM = 70.0  # from the vertex down: there the length of a head is measured
USUAL_HALF_LENGTH_MM = 95.0
APART_MM = 2.5  # added to both: distance of its samples
BELOW_CHIN_MM = 12.0  # lowest skin in a CT of head and chin

RAYS = 900  # over half the head, to which the other half is alike: 5 degrees apart
OUTSIDE_MM = 250.0  # from the centre: outside every head
RING = 61  # rays over half a ring: 3 degrees apart
GOLDEN_RAD = np.pi * (3.0 - 5.0**0.5)
ROUNDS = 250  # after which the axes are exact to 0.3 mm


class Ellipsoid(NamedTuple):
    """Ellipsoid along the axes of the CT frame."""

    centre_mm: Point
    semi_axes_mm: Point


def cover_head(head: ParametricHead) -> tuple[Ellipsoid, Ellipsoid]:
    """Return the ellipsoids around the cranium and around what is below it."""
    vertex_mm = head.semi_axes_mm[2]
    half_length_mm = 0.5 * np.ptp(_sample_ring(head, vertex_mm - MEASURED_MM)[:, 1])
    border_mm = vertex_mm - CRANIUM_MM * half_length_mm / USUAL_HALF_LENGTH_MM
    points, ring = _sample_skin(head), _sample_ring(head, border_mm)
    is_cranium = points[:, 2] > border_mm
    cranium = points[is_cranium]
    mirrored = cranium * (1.0, 1.0, -1.0) + (0.0, 0.0, 2.0 * border_mm)
    return (
        _cover(head, np.vstack([cranium, mirrored, ring])),
        _cover(head, np.vstack([points[~is_cranium], ring])),
    )


def _cover(head: ParametricHead, points_mm: Vectors) -> Ellipsoid:
    centre, semi_axes = fit_least_ellipsoid(points_mm)
    return Ellipsoid(as_point(centre + head.centre_ct_mm), as_point(semi_axes + APART_MM))


def _sample_skin(head: ParametricHead) -> Vectors:
    """Return points (n, 3) of the skin all around, from the centre of the cranium."""
    number = np.arange(2 * RAYS)
    height = 1.0 - (number + 0.5) / RAYS
    across = np.sqrt(1.0 - height**2)
    rays = np.column_stack(
        [across * np.cos(GOLDEN_RAD * number), across * np.sin(GOLDEN_RAD * number), height]
    )
    points = _meet(head, 0.0, rays[rays[:, 0] >= 0.0])
    return points[points[:, 2] > head.landmarks.menton_mm - BELOW_CHIN_MM]


def _sample_ring(head: ParametricHead, height_mm: float) -> Vectors:
    """Return points (n, 3) of the skin at a height, from the centre of the cranium."""
    turns = np.linspace(-0.5 * np.pi, 0.5 * np.pi, RING)
    return _meet(head, height_mm, np.column_stack([np.cos(turns), np.sin(turns), np.zeros(RING)]))


def _meet(head: ParametricHead, height_mm: float, rays: Vectors) -> Vectors:
    """Return where rays to the left leave the head from a height on its middle axis, and the mirror image."""
    middle = np.array([0.0, 0.0, height_mm])
    starts = middle + head.centre_ct_mm + OUTSIDE_MM * rays
    away_mm = OUTSIDE_MM - march(head.distance_mm, starts, -rays, OUTSIDE_MM)
    points = middle + (away_mm[:, None] * rays)[np.isfinite(away_mm)]
    return np.vstack([points, points * (-1.0, 1.0, 1.0)])


def fit_least_ellipsoid(points_mm: Vectors) -> tuple[Array, Array]:
    """Return centre and semi-axes, (3,) each, of the smallest ellipsoid along the axes around points (n, 3).

    Weights of the points grow where they are far outside (Titterington, Appl. Statist. 27:227, 1978), which
    ends with the dual optimum: then the weights' means and variances give centre and axes.
    """
    weights = np.full(len(points_mm), 1.0 / len(points_mm))
    squares = points_mm**2
    for _ in range(ROUNDS):
        centre = weights @ points_mm
        variances = weights @ squares - centre**2
        outside = ((points_mm - centre) ** 2) @ (1.0 / variances) / 3.0
        weights = weights * outside
    return centre, np.sqrt(3.0 * variances * outside.max())
