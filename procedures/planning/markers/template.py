"""Proposes positions for three or four markers on a head such that all their distances differ by a margin.

The thesis advises such a template for so few markers. Among the possible sites, those with the least expected
error at the centre of the head are chosen (eq. 39).
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from procedures.planning.errors import NoTemplate
from procedures.planning.head.shape import HeadEllipsoid
from procedures.planning.head.tissue import AIR_BELOW_HU, sampled_hu
from procedures.registration.error_theory import tre_principal_axes_mm
from ronna_hw.marker_template import MarkerTemplate, TemplateMarker

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

CAP_AXIS = (0.0, -1.0, 1.0)  # LPS, from forehead to vertex: excludes pillow and face
CAP_HALF_ANGLE_RAD = np.radians(50.0)
STANDOFF_MM = 16.0  # from the skin to a sphere's centre: base and half a sphere
APART_MM = 38.0  # between two markers, so that the stereo head sees one at a time
SITES, DRAWS = 600, 60_000
SKIN_STEP_MM = 0.5
SKIN_MM = (25.0, -40.0)  # range searched for skin: outside the ellipsoid, inside it
AROUND, RING_MM = 8, 14.0  # points around a site: a sphere, post or bolt covers few of them
FREE_SKIN_MM = 4.0  # a site is no higher and no lower than these
SKIN_THICK_MM = 4.0  # anything thinner is a sheet or a cable


def propose_template(
    head: HeadEllipsoid,
    markers: int,
    margin_mm: float,
    *,
    volume: Volume | None = None,
    seed: int = 0,
) -> MarkerTemplate:
    """Positions for `markers` spheres (3 or 4) whose distances differ by at least `margin_mm`.

    On the skin shown by the CT, or on the ellipsoid without one. Raises PLAN-015 with the
    largest margin found.
    """
    random = np.random.default_rng(seed)
    centres, posts = sites_on(head, volume, random)
    if len(centres) < markers:
        raise NoTemplate("the CT shows no skin between forehead and vertex", got=f"{len(centres)} positions")
    sets = random.integers(len(centres), size=(DRAWS, markers))
    points = centres[sets]
    first, second = np.array(list(combinations(range(markers), 2))).T
    distances = np.sort(np.linalg.norm(points[:, first] - points[:, second], axis=2), axis=1)
    apart = distances[:, 0] >= APART_MM
    margins = np.where(apart, np.diff(distances, axis=1).min(axis=1), 0.0)
    if margins.max() < margin_mm:
        raise NoTemplate(
            f"no {markers} positions have distances that differ that much",
            expected=f"{margin_mm:g} mm",
            got=f"at most {margins.max():.1f} mm",
        )
    good = np.flatnonzero(margins >= margin_mm)
    expected = tre_principal_axes_mm(np.array([head.centre_mm]), points[good], 1.0)
    best = good[int(expected.argmin())]
    return MarkerTemplate(
        markers=tuple(
            TemplateMarker(centre_mm=_three(centres[site]), post=_three(posts[site])) for site in sets[best]
        )
    )


def sites_on(head: HeadEllipsoid, volume: Volume | None, random: np.random.Generator) -> tuple[Array, Array]:
    """Possible centres of spheres (s, 3) and their posts (s, 3)."""
    axes, middle = np.array(head.semi_axes_mm), np.array(head.centre_mm)
    directions = _cap(random)
    skin = directions / np.linalg.norm(directions / axes, axis=1, keepdims=True)
    posts = skin / axes**2
    posts /= np.linalg.norm(posts, axis=1, keepdims=True)
    skin = skin + middle
    if volume is not None:
        depth = np.array([_above_skin_mm(volume, one, post) for one, post in zip(skin, posts, strict=True)])
        seen = np.isfinite(depth)
        skin, posts = skin[seen] + depth[seen, None] * posts[seen], posts[seen]
    return skin + STANDOFF_MM * posts, posts


def _cap(random: np.random.Generator) -> Array:
    """Directions (s, 3), uniform over the cap."""
    cosine = random.uniform(np.cos(CAP_HALF_ANGLE_RAD), 1.0, SITES)
    turn, sine = random.uniform(0.0, 2.0 * np.pi, SITES), np.sqrt(1.0 - cosine**2)
    axis = np.array(CAP_AXIS) / np.linalg.norm(CAP_AXIS)
    side = np.array([1.0, 0.0, 0.0])
    return np.asarray(
        np.outer(cosine, axis)
        + np.outer(sine * np.cos(turn), side)
        + np.outer(sine * np.sin(turn), np.cross(axis, side))
    )


def _above_skin_mm(volume: Volume, at_mm: Array, outward: Array) -> float:
    """Distance outwards from a point to the skin; NaN if the CT shows none, or something on it."""
    side = np.cross(outward, np.eye(3)[np.abs(outward).argmin()])
    side /= np.linalg.norm(side)
    turns = np.arange(AROUND) * 2.0 * np.pi / AROUND
    ring = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), np.cross(outward, side))
    here = _first_solid_mm(volume, at_mm, outward)
    around = np.median([_first_solid_mm(volume, at_mm + RING_MM * one, outward) for one in ring])
    return here if abs(here - around) < FREE_SKIN_MM else float("nan")


def _first_solid_mm(volume: Volume, at_mm: Array, outward: Array) -> float:
    """Distance outwards from a point to the first object that is not a sheet; NaN without one."""
    steps_mm = np.arange(SKIN_MM[0], SKIN_MM[1], -SKIN_STEP_MM)
    hu = sampled_hu(volume, at_mm + steps_mm[:, None] * outward)
    if len(hu) < len(steps_mm):
        return float("nan")  # beyond the CT
    solid = np.convolve(hu > AIR_BELOW_HU, np.ones(round(SKIN_THICK_MM / SKIN_STEP_MM)), "valid")
    first = np.flatnonzero(solid == round(SKIN_THICK_MM / SKIN_STEP_MM))
    return float(steps_mm[first[0]]) if len(first) else float("nan")


def _three(vector: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in vector)
    return x, y, z
