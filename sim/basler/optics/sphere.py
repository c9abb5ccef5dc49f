"""Images of a retro-reflective sphere, exact at the rim, and of its stalk.

Lit from around the lens, the film returns light to the camera from everywhere, a quarter less at the limb.
Inside, one ray per pixel; in a band along the rim 4 x 4 exact rays per pixel, each weighted by its distance
inside the outline. The rim is therefore accurate to about 0.001 px.

The stalk extends from below into the sphere. Seen from the side its flange covers part of the rim; seen from
above it is behind the sphere and its outer edge touches the image of the rim. All of it is darker than film.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Dot, Image, Lens, PixelCanvas, Rays, bounds_of, row_bands
from sim.basler.optics.film import Film
from sim.world.rigid import Vector

Values = NDArray[np.floating[Any]]

LIMB_DARKENING = 0.25  # less light from the limb than from the centre
BAND_PX = 1.1  # half a pixel's diagonal, plus half a sample, plus the error of the linear rays
SAMPLES = 4  # per pixel and axis, in the band
OUTLINE_POINTS = 90


@dataclass(frozen=True)
class DrawnSphere:
    """A sphere in the camera frame, in millimetres.

    The third column of `camera_from_sphere` (3, 3) points along the post, from the skull to the sphere.
    """

    centre_mm: Vector
    radius_mm: float
    camera_from_sphere: Vector
    number: int

    @cached_property
    def distance_mm(self) -> float:
        """Distance from the centre of projection to the centre of the sphere."""
        return float(np.linalg.norm(self.centre_mm))

    @cached_property
    def tangent_mm(self) -> float:
        """Distance from the centre of projection to the tangent points."""
        return float((self.distance_mm**2 - self.radius_mm**2) ** 0.5)

    def outline_mm(self) -> Vector:
        """Return points (n, 3) on the circle where rays are tangent to the sphere."""
        axis = self.centre_mm / self.distance_mm
        across = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[0]) > 0.5 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        angle = np.linspace(0.0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)[:, None]
        circle = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
        share = self.tangent_mm / self.distance_mm
        points: Vector = axis * (share * self.tangent_mm) + circle * (share * self.radius_mm)
        return points


@dataclass(frozen=True)
class BodyImage:
    """Per-pixel coverage, light and depth of `area`, with infinite depth where the pixel centre misses."""

    area: Area
    cover: Image
    light: Image
    depth_mm: Image


def draw_sphere(sphere: DrawnSphere, lens: Lens, area: Area, film: Film) -> BodyImage:
    """Draw a sphere of unit brightness over `area`."""
    shape = (area.height, area.width)
    rays = SphereRays.of(sphere, Rays(lens, area))
    image = BodyImage(area, *(np.empty(shape, np.float32) for _ in range(3)))
    rims = []
    for rows in row_bands(*shape):
        inside_px = _draw_inside(sphere, lens, film, rays, image, rows)
        below, right = np.nonzero(np.abs(inside_px) <= BAND_PX)
        rims.append((below + rows.start, right))
    if rims:
        rim = tuple(np.concatenate(parts) for parts in zip(*rims, strict=True))
        _sample_rim(sphere, lens, film, rim, image)
    return image


@dataclass(frozen=True)
class SphereRays:
    """Rays of an area, with the dot products for drawing a sphere."""

    rays: Rays
    along: Dot  # the centre projected on each ray, times the ray's length
    across: tuple[Dot, Dot, Dot]  # the cross product of each ray with the centre
    axes: tuple[Dot, Dot, Dot]

    @classmethod
    def of(cls, sphere: DrawnSphere, rays: Rays) -> SphereRays:
        """Compute the dot products of an area's rays for a sphere."""
        x, y, z = sphere.centre_mm
        across = ([z, 0.0, -x], [0.0, z, -y], [y, -x, 0.0])
        first, second, third = (rays.dot(np.array(each)) for each in across)
        right, down, post = (rays.dot(axis) for axis in sphere.camera_from_sphere.T)
        return cls(rays, rays.dot(sphere.centre_mm), (first, second, third), (right, down, post))

    def squared_miss_distance(self, rows: slice) -> Image:
        """Return the squared cross product of each ray and the centre: (miss distance times ray length)^2.

        Unlike a difference of large squares it keeps its digits in single precision.
        """
        total = self.across[0].sum_rows(rows)
        total *= total
        part = np.empty_like(total)
        for across in self.across[1:]:
            across.sum_rows(rows, part)
            part *= part
            total += part
        return total


def _draw_inside(
    sphere: DrawnSphere, lens: Lens, film: Film, rays: SphereRays, image: BodyImage, rows: slice
) -> Image:
    """Draw some rows with one ray per pixel and return each pixel's depth inside the outline."""
    miss = rays.squared_miss_distance(rows)
    squared = rays.rays.square_rows(rows)
    inside_px: Image = miss / squared
    np.sqrt(inside_px, out=inside_px)
    np.subtract(np.float32(sphere.radius_mm), inside_px, out=inside_px)
    inside_px *= np.float32(lens.focal_px[0] / sphere.tangent_mm)
    # discriminant of the ray's intersections with the sphere; negative outside
    discriminant = squared * np.float32(sphere.radius_mm**2)
    discriminant -= miss
    outside = discriminant < 0.0
    np.maximum(discriminant, np.float32(0.0), out=discriminant)
    depth = image.depth_mm[rows]
    rays.along.sum_rows(rows, depth)
    depth -= np.sqrt(discriminant, out=miss)
    depth /= squared
    dots = (axis.sum_rows(rows) for axis in rays.axes)
    np.multiply(
        _limb_brightness(discriminant, squared, sphere),
        film.brightness_at(*_surface_points(sphere, depth, dots)),
        out=image.light[rows],
    )
    np.copyto(depth, np.float32(np.inf), where=outside)
    image.cover[rows] = inside_px > 0.0
    return inside_px


def _sample_rim(
    sphere: DrawnSphere, lens: Lens, film: Film, band: tuple[NDArray[np.intp], ...], image: BodyImage
) -> None:
    rows, columns = band
    if not len(rows):
        return
    centres = np.column_stack([columns + image.area.x, rows + image.area.y]).astype(float)
    middle_x, middle_y = lens.rays(centres).T.copy()
    # Over one pixel the rays are linear to 1e-7 px: one derivative for the whole band suffices.
    here = centres.mean(axis=0)
    probe = lens.rays(here + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    per_column, per_row = probe[1] - probe[0], probe[2] - probe[0]
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    covered = np.zeros(len(rows))
    weighted = np.zeros(len(rows))
    for right in steps:
        # the samples of a column below each other: (SAMPLES, pixels)
        x = (middle_x + right * per_column[0]) + (steps * per_row[0])[:, None]
        y = (middle_y + right * per_column[1]) + (steps * per_row[1])[:, None]
        squared = x * x + y * y + 1.0
        along = x * sphere.centre_mm[0] + y * sphere.centre_mm[1] + sphere.centre_mm[2]
        inside_px = (along / np.sqrt(squared) - sphere.tangent_mm) * (lens.focal_px[0] / sphere.radius_mm)
        share = np.clip(0.5 + SAMPLES * inside_px, 0.0, 1.0)
        discriminant = np.maximum(along * along - squared * sphere.tangent_mm**2, 0.0)
        depth = (along - np.sqrt(discriminant)) / squared
        dots = (x * axis[0] + y * axis[1] + axis[2] for axis in sphere.camera_from_sphere.T)
        light = (
            share
            * _limb_brightness(discriminant, squared, sphere)
            * film.brightness_at(*_surface_points(sphere, depth, dots))
        )
        for share_below, light_below in zip(share, light, strict=True):
            covered += share_below
            weighted += light_below
    image.cover[rows, columns] = covered / SAMPLES**2
    image.light[rows, columns] = weighted / np.maximum(covered, np.finfo(float).tiny)


def _limb_brightness(discriminant: Values, squared: Values, sphere: DrawnSphere) -> Values:
    """Return the brightness at an angle of incidence given by cos^2 = discriminant / (radius^2 ray^2)."""
    limb: Values = discriminant / squared
    limb *= LIMB_DARKENING / sphere.radius_mm**2
    limb += 1.0 - LIMB_DARKENING
    return limb


def _surface_points(sphere: DrawnSphere, depth: Values, dots: Iterator[Values]) -> Iterator[Image]:
    """Yield x, y, z of the surface points in the sphere's frame, with `dots` for the rays along its axes."""
    for axis, dot in zip(sphere.camera_from_sphere.T, dots, strict=True):
        dot *= depth
        point: Image = dot.astype(np.float32, copy=False)
        point -= np.float32(axis @ sphere.centre_mm)
        yield point


SIDE_DARKENING = 0.6  # a cylinder's edge is this much darker than its middle
STALK_OUTLINE_POINTS = 16
SMALLEST_ACROSS = 1e-6  # keeps divisions finite for rays along or across the axis


@dataclass(frozen=True)
class Section:
    """A cylindrical section of the stalk, bounded by distances from the sphere's centre towards the skull."""

    begin_mm: float
    end_mm: float
    radius_mm: float
    brightness: float  # relative to the film


SECTIONS = (
    Section(4.6, 6.6, 3.5, 0.12),  # flange that the sphere sits on
    Section(6.6, 14.0, 2.0, 0.18),  # post
    Section(14.0, 16.0, 3.5, 0.10),  # head of the bone screw
)


def stalk_outline_mm(sphere: DrawnSphere, sections: Sequence[Section] = SECTIONS) -> Vector:
    """Return points (n, 3) enclosing a sphere's stalk or the given sections of it."""
    across, over, post = sphere.camera_from_sphere.T
    angle = np.linspace(0.0, 2 * np.pi, STALK_OUTLINE_POINTS, endpoint=False)[:, None]
    circle = np.cos(angle) * across + np.sin(angle) * over
    rings = [
        sphere.centre_mm - along * post + section.radius_mm * circle
        for section in sections
        for along in (section.begin_mm, section.end_mm)
    ]
    return np.concatenate(rings)


def draw_stalk(sphere: DrawnSphere, lens: Lens, area: Area) -> BodyImage:
    """Draw the stalk of a sphere with unit brightness over `area`."""
    shape = (area.height, area.width)
    image = BodyImage(
        area, np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    )
    for section in SECTIONS:
        part = bounds_of(lens, stalk_outline_mm(sphere, (section,))).intersect(area)
        if not part.empty:
            _draw_section(image, part, sphere, section, lens)
    return image


def _draw_section(image: BodyImage, part: Area, sphere: DrawnSphere, section: Section, lens: Lens) -> None:
    rays = Rays(lens, part)
    layers = [PixelCanvas(image.area, each).part(part) for each in (image.cover, image.light, image.depth_mm)]
    # From the skull end up to the sphere: seen from above, the axis points to the camera.
    axis = sphere.camera_from_sphere[:, 2]
    foot = sphere.centre_mm - section.end_mm * axis
    length = section.end_mm - section.begin_mm
    px_per_mm = lens.focal_px[0] / sphere.distance_mm
    # The end facing the camera covers the side.
    end_mm = length if foot @ axis + length < 0 else 0.0
    end_centre = foot + end_mm * axis
    along_axis = rays.dot(axis)
    towards_foot, towards_end = rays.dot(foot - float(foot @ axis) * axis), rays.dot(end_centre)
    for rows in row_bands(part.height, part.width):
        along, squared = along_axis.sum_rows(rows), rays.square_rows(rows)
        side = _draw_side(along, squared, towards_foot.sum_rows(rows), foot, axis, section, px_per_mm)
        end = _draw_end(along, squared, towards_end.sum_rows(rows), end_centre, axis, section, px_per_mm)
        _add_section([each[rows] for each in layers], side, end)


Drawn = tuple[Image, Image, Image]  # cover, light and depth


def _add_section(layers: Sequence[Image], side: Drawn, end: Drawn) -> None:
    """Composite the side and end of a section into the layers where they are nearer; overwrites `side`."""
    cover, light, depth = side
    end_cover, end_light, end_depth = end
    on_end = end_cover > cover
    for one, other in ((cover, end_cover), (light, end_light), (depth, end_depth)):
        np.copyto(one, other, where=on_end)
    nearer = (cover > 0.0) & (depth < layers[2])
    np.copyto(layers[0], np.maximum(cover, layers[0]), where=nearer)
    np.copyto(layers[1], light, where=nearer)
    np.copyto(layers[2], depth, where=nearer)


def _draw_side(
    along_axis: Image,
    squared: Image,
    towards: Image,
    foot: Vector,
    axis: Vector,
    section: Section,
    px_per_mm: float,
) -> Drawn:
    """Draw the curved side; `towards` projects the axis point nearest the camera on each ray."""
    radius, length = section.radius_mm, section.end_mm - section.begin_mm
    foot_along = float(foot @ axis)
    across = along_axis * along_axis  # squared component of the ray perpendicular to the axis
    np.subtract(squared, across, out=across)
    np.maximum(across, np.float32(SMALLEST_ACROSS), out=across)
    # squared distance between ray and axis, and half the ray's chord in the cylinder
    distance2 = towards * towards
    distance2 /= across
    np.subtract(np.float32(foot @ foot - foot_along**2), distance2, out=distance2)
    np.maximum(distance2, np.float32(0.0), out=distance2)
    chord = np.float32(radius**2) - distance2
    np.maximum(chord, np.float32(0.0), out=chord)
    chord /= across
    np.sqrt(chord, out=chord)
    depth = towards / across
    depth -= chord
    height = depth * along_axis
    height -= np.float32(foot_along)
    cover = _edge_cover(np.sqrt(distance2, out=distance2), radius, px_per_mm)
    cover *= (height >= 0.0) & (height <= length)
    light: Image = np.sqrt(across, out=across)
    light *= chord
    light *= np.float32(section.brightness * SIDE_DARKENING / radius)
    light += np.float32(section.brightness * (1 - SIDE_DARKENING))
    return cover, light, depth


def _draw_end(
    along_axis: Image,
    squared: Image,
    towards: Image,
    centre: Vector,
    axis: Vector,
    section: Section,
    px_per_mm: float,
) -> Drawn:
    """Draw a flat end; `towards` is its centre, projected on each ray."""
    upright = np.abs(along_axis)
    depth = np.where(upright < SMALLEST_ACROSS, np.float32(SMALLEST_ACROSS), along_axis)
    np.divide(np.float32(centre @ axis), depth, out=depth)
    off2 = depth * depth
    off2 *= squared
    twice = np.float32(2.0) * depth
    twice *= towards
    off2 -= twice
    off2 += np.float32(centre @ centre)
    np.maximum(off2, np.float32(0.0), out=off2)
    cover = _edge_cover(np.sqrt(off2, out=off2), section.radius_mm, px_per_mm)
    cover *= depth > 0.0
    light: Image = upright
    light /= np.sqrt(squared, out=twice)
    light *= np.float32(section.brightness)
    return cover, light, depth


def _edge_cover(distance_mm: Image, radius_mm: float, px_per_mm: float) -> Image:
    """Convert pixel distances from the axis to pixel coverage, in place."""
    cover = distance_mm
    np.subtract(np.float32(radius_mm), distance_mm, out=cover)
    cover *= np.float32(px_per_mm)
    cover += np.float32(0.5)
    np.clip(cover, 0.0, 1.0, out=cover)
    return cover
