"""The post of a sphere with flange and base on the skull, all darker than the film.

A stalk extends from below into the sphere. Seen from the side its flange covers part of the sphere's rim;
seen from above it is behind the sphere and its outer edge touches the image of the rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Canvas, Image, Rays, bounds_of, row_bands
from sim.basler.optics.lens import Lens
from sim.basler.optics.sphere import Sphere

Vector = NDArray[np.float64]

SIDE_DARKENING = 0.6  # a cylinder's edge is this much darker than its middle
OUTLINE_POINTS = 16
SMALLEST_ACROSS = 1e-6  # keeps divisions finite for rays along or across the axis


@dataclass(frozen=True)
class Section:
    """A cylinder on the stalk's axis; distances from the sphere's centre towards the skull."""

    begin_mm: float
    end_mm: float
    radius_mm: float
    brightness: float  # relative to the film


SECTIONS = (
    Section(4.6, 6.6, 3.5, 0.12),  # flange that the sphere sits on
    Section(6.6, 14.0, 2.0, 0.18),  # post
    Section(14.0, 16.0, 3.5, 0.10),  # head of the bone screw
)


@dataclass(frozen=True)
class StalkImage:
    """Per pixel of `area`: coverage, light, depth (infinite where empty)."""

    area: Area
    cover: Image
    light: Image
    depth_mm: Image


def outline_mm(sphere: Sphere, sections: Sequence[Section] = SECTIONS) -> Vector:
    """Points (n, 3) that enclose a sphere's stalk, or some of its sections."""
    across, over, post = sphere.camera_from_sphere.T
    angle = np.linspace(0.0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)[:, None]
    circle = np.cos(angle) * across + np.sin(angle) * over
    rings = [
        sphere.centre_mm - along * post + section.radius_mm * circle
        for section in sections
        for along in (section.begin_mm, section.end_mm)
    ]
    return np.concatenate(rings)


def image_of(sphere: Sphere, lens: Lens, area: Area) -> StalkImage:
    """Draw the stalk of a sphere of unit brightness over `area`."""
    shape = (area.height, area.width)
    image = StalkImage(
        area, np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    )
    for section in SECTIONS:
        part = bounds_of(lens, outline_mm(sphere, (section,))).common(area)
        if not part.empty:
            _add(image, part, sphere, section, lens)
    return image


def _add(image: StalkImage, part: Area, sphere: Sphere, section: Section, lens: Lens) -> None:
    whole = Rays(lens, part)
    kept = [Canvas(image.area, each).part(part) for each in (image.cover, image.light, image.depth_mm)]
    for rows in row_bands(part.height, part.width):
        _add_rows([each[rows] for each in kept], whole.in_rows(rows), sphere, section, lens)


def _add_rows(kept: Sequence[Image], rays: Rays, sphere: Sphere, section: Section, lens: Lens) -> None:
    """Draw some rows of a section over the cover, light and depth in `kept`."""
    # From the skull end up to the sphere: seen from above, the axis points to the camera.
    axis = sphere.camera_from_sphere[:, 2]
    foot = sphere.centre_mm - section.end_mm * axis
    length = section.end_mm - section.begin_mm
    px_per_mm = lens.focal_px[0] / sphere.distance_mm
    along_axis = rays.dot(axis)
    cover, light, depth = _side(rays, along_axis, foot, axis, section, px_per_mm)
    # The end facing the camera covers the side.
    end_mm = length if foot @ axis + length < 0 else 0.0
    end_cover, end_light, end_depth = _end(rays, along_axis, foot + end_mm * axis, axis, section, px_per_mm)
    on_end = end_cover > cover
    for whole, end in ((cover, end_cover), (light, end_light), (depth, end_depth)):
        np.copyto(whole, end, where=on_end)
    nearer = (cover > 0.0) & (depth < kept[2])
    np.copyto(kept[0], np.maximum(cover, kept[0]), where=nearer)
    np.copyto(kept[1], light, where=nearer)
    np.copyto(kept[2], depth, where=nearer)


def _side(
    rays: Rays, along_axis: Image, foot: Vector, axis: Vector, section: Section, px_per_mm: float
) -> tuple[Image, Image, Image]:
    """Coverage, light and depth of the curved side."""
    radius, length = section.radius_mm, section.end_mm - section.begin_mm
    foot_along = float(foot @ axis)
    across = rays.squared - along_axis * along_axis  # squared component of the ray perpendicular to the axis
    np.maximum(across, np.float32(SMALLEST_ACROSS), out=across)
    towards = rays.dot(foot - foot_along * axis)  # the axis, projected on each ray
    # squared distance between ray and axis, and half the ray's chord in the cylinder
    distance2 = np.float32(foot @ foot - foot_along**2) - towards * towards / across
    np.maximum(distance2, np.float32(0.0), out=distance2)
    chord = np.sqrt(np.maximum(np.float32(radius**2) - distance2, np.float32(0.0)) / across)
    depth: Image = (towards / across - chord).astype(np.float32, copy=False)
    height = depth * along_axis - np.float32(foot_along)
    cover = _ramp(np.float32(radius) - np.sqrt(distance2), px_per_mm)
    cover *= (height >= 0.0) & (height <= length)
    light: Image = (np.sqrt(across) * chord).astype(np.float32, copy=False)
    light *= np.float32(section.brightness * SIDE_DARKENING / radius)
    light += np.float32(section.brightness * (1 - SIDE_DARKENING))
    return cover, light, depth


def _end(
    rays: Rays, along_axis: Image, centre: Vector, axis: Vector, section: Section, px_per_mm: float
) -> tuple[Image, Image, Image]:
    """Coverage, light and depth of a flat end."""
    steep = np.where(np.abs(along_axis) < SMALLEST_ACROSS, np.float32(SMALLEST_ACROSS), along_axis)
    depth: Image = (np.float32(centre @ axis) / steep).astype(np.float32, copy=False)
    off2 = depth * depth * rays.squared - 2.0 * depth * rays.dot(centre) + np.float32(centre @ centre)
    cover = _ramp(np.float32(section.radius_mm) - np.sqrt(np.maximum(off2, np.float32(0.0))), px_per_mm)
    cover *= depth > 0.0
    light: Image = (np.abs(along_axis) / np.sqrt(rays.squared)).astype(np.float32, copy=False)
    light *= np.float32(section.brightness)
    return cover, light, depth


def _ramp(inside_mm: Image, px_per_mm: float) -> Image:
    """Coverage of a pixel by how far inside an edge its centre is."""
    cover: Image = np.clip(np.float32(0.5) + inside_mm * np.float32(px_per_mm), 0.0, 1.0)
    return cover
