"""The image of one retro-reflective sphere, exact at the rim, and of the stalk that carries it.

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
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Canvas, Image, Lens, Rays, bounds_of, row_bands
from sim.basler.optics.film import Film

Vector = NDArray[np.float64]
Values = NDArray[np.floating[Any]]

LIMB_DARKENING = 0.25  # less light from the limb than from the centre
BAND_PX = 1.1  # half a pixel's diagonal, plus half a sample, plus the error of the linear rays
SAMPLES = 4  # per pixel and axis, in the band
OUTLINE_POINTS = 90


@dataclass(frozen=True)
class Sphere:
    """A sphere in the camera frame, millimetres.

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
        """Distance from the centre of projection to the points of tangency."""
        return float((self.distance_mm**2 - self.radius_mm**2) ** 0.5)

    def outline_mm(self) -> Vector:
        """Return points (n, 3) of the circle where rays are tangent to the sphere."""
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
    """Coverage, light and depth per pixel of `area`; depth is infinite where a pixel's centre misses."""

    area: Area
    cover: Image
    light: Image
    depth_mm: Image


def draw_sphere(sphere: Sphere, lens: Lens, area: Area, film: Film) -> BodyImage:
    """Draw a sphere of unit brightness over `area`."""
    shape = (area.height, area.width)
    whole = Rays(lens, area)
    image = BodyImage(area, *(np.empty(shape, np.float32) for _ in range(3)))
    rims = []
    for rows in row_bands(*shape):
        inside_px = _draw_inside(sphere, lens, film, whole.select_rows(rows), image, rows)
        below, right = np.nonzero(np.abs(inside_px) <= BAND_PX)
        rims.append((below + rows.start, right))
    if rims:
        rim = tuple(np.concatenate(parts) for parts in zip(*rims, strict=True))
        _sample_rim(sphere, lens, film, rim, image)
    return image


def _draw_inside(sphere: Sphere, lens: Lens, film: Film, rays: Rays, image: BodyImage, rows: slice) -> Image:
    """Draw some rows, one ray per pixel; returns how far inside the outline each pixel is."""
    along = rays.dot(sphere.centre_mm)  # the centre projected on each ray, times the ray's length
    miss = _squared_miss_distance(rays, sphere)
    inside_px: Image = sphere.radius_mm - np.sqrt(miss / rays.squared)
    inside_px *= np.float32(lens.focal_px[0] / sphere.tangent_mm)
    # discriminant of the ray's intersections with the sphere; negative outside
    discriminant = rays.squared * np.float32(sphere.radius_mm**2)
    discriminant -= miss
    outside = discriminant < 0.0
    np.maximum(discriminant, np.float32(0.0), out=discriminant)
    depth = (along - np.sqrt(discriminant)) / rays.squared
    dots = (rays.dot(axis) for axis in sphere.camera_from_sphere.T)
    np.multiply(
        _limb_brightness(discriminant, rays.squared, sphere),
        film.brightness_at(*_surface_points(sphere, depth, dots)),
        out=image.light[rows],
    )
    depth[outside] = np.inf
    image.depth_mm[rows] = depth
    image.cover[rows] = inside_px > 0.0
    return inside_px


def _squared_miss_distance(rays: Rays, sphere: Sphere) -> Image:
    """Return the squared cross product of each ray with the centre: (miss distance times ray length)^2.

    Unlike a difference of large squares it keeps its digits in single precision.
    """
    x, y, z = sphere.centre_mm
    total = rays.dot(np.array([z, 0.0, -x]))
    total *= total
    for across in ([0.0, z, -y], [y, -x, 0.0]):
        part = rays.dot(np.array(across))
        part *= part
        total += part
    return total


def _sample_rim(
    sphere: Sphere, lens: Lens, film: Film, band: tuple[NDArray[np.intp], ...], image: BodyImage
) -> None:
    rows, columns = band
    if not len(rows):
        return
    centres = np.column_stack([columns + image.area.x, rows + image.area.y]).astype(float)
    middle = lens.rays(centres)
    # Over one pixel the rays are linear to 1e-7 px: one derivative for the whole band suffices.
    here = centres.mean(axis=0)
    probe = lens.rays(here + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    covered = np.zeros(len(rows))
    weighted = np.zeros(len(rows))
    for right, down in product(steps, steps):
        x, y = (middle + right * (probe[1] - probe[0]) + down * (probe[2] - probe[0])).T
        squared = x * x + y * y + 1.0
        along = x * sphere.centre_mm[0] + y * sphere.centre_mm[1] + sphere.centre_mm[2]
        inside_px = (along / np.sqrt(squared) - sphere.tangent_mm) * (lens.focal_px[0] / sphere.radius_mm)
        share = np.clip(0.5 + SAMPLES * inside_px, 0.0, 1.0)
        discriminant = np.maximum(along * along - squared * sphere.tangent_mm**2, 0.0)
        depth = (along - np.sqrt(discriminant)) / squared
        dots = (x * axis[0] + y * axis[1] + axis[2] for axis in sphere.camera_from_sphere.T)
        covered += share
        weighted += (
            share
            * _limb_brightness(discriminant, squared, sphere)
            * film.brightness_at(*_surface_points(sphere, depth, dots))
        )
    image.cover[rows, columns] = covered / SAMPLES**2
    image.light[rows, columns] = weighted / np.maximum(covered, np.finfo(float).tiny)


def _limb_brightness(discriminant: Values, squared: Values, sphere: Sphere) -> Values:
    """Return the brightness by angle of incidence, with cos^2 = discriminant / (radius^2 ray^2)."""
    limb: Values = discriminant / squared
    limb *= LIMB_DARKENING / sphere.radius_mm**2
    limb += 1.0 - LIMB_DARKENING
    return limb


def _surface_points(sphere: Sphere, depth: Values, dots: Iterator[Values]) -> Iterator[Image]:
    """Yield x, y, z of the surface points in the sphere's frame; `dots` are the rays along its axes."""
    for axis, dot in zip(sphere.camera_from_sphere.T, dots, strict=True):
        point: Image = (depth * dot).astype(np.float32, copy=False)
        point -= np.float32(axis @ sphere.centre_mm)
        yield point


SIDE_DARKENING = 0.6  # a cylinder's edge is this much darker than its middle
STALK_OUTLINE_POINTS = 16
SMALLEST_ACROSS = 1e-6  # keeps divisions finite for rays along or across the axis


@dataclass(frozen=True)
class Section:
    """A cylinder on the stalk's axis; distances are from the sphere's centre towards the skull."""

    begin_mm: float
    end_mm: float
    radius_mm: float
    brightness: float  # relative to the film


SECTIONS = (
    Section(4.6, 6.6, 3.5, 0.12),  # flange that the sphere sits on
    Section(6.6, 14.0, 2.0, 0.18),  # post
    Section(14.0, 16.0, 3.5, 0.10),  # head of the bone screw
)


def stalk_outline_mm(sphere: Sphere, sections: Sequence[Section] = SECTIONS) -> Vector:
    """Return points (n, 3) that enclose a sphere's stalk, or some of its sections."""
    across, over, post = sphere.camera_from_sphere.T
    angle = np.linspace(0.0, 2 * np.pi, STALK_OUTLINE_POINTS, endpoint=False)[:, None]
    circle = np.cos(angle) * across + np.sin(angle) * over
    rings = [
        sphere.centre_mm - along * post + section.radius_mm * circle
        for section in sections
        for along in (section.begin_mm, section.end_mm)
    ]
    return np.concatenate(rings)


def draw_stalk(sphere: Sphere, lens: Lens, area: Area) -> BodyImage:
    """Draw the stalk of a sphere of unit brightness over `area`."""
    shape = (area.height, area.width)
    image = BodyImage(
        area, np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    )
    for section in SECTIONS:
        part = bounds_of(lens, stalk_outline_mm(sphere, (section,))).intersect(area)
        if not part.empty:
            _draw_section(image, part, sphere, section, lens)
    return image


def _draw_section(image: BodyImage, part: Area, sphere: Sphere, section: Section, lens: Lens) -> None:
    whole = Rays(lens, part)
    layers = [Canvas(image.area, each).part(part) for each in (image.cover, image.light, image.depth_mm)]
    for rows in row_bands(part.height, part.width):
        _draw_section_rows([each[rows] for each in layers], whole.select_rows(rows), sphere, section, lens)


def _draw_section_rows(
    layers: Sequence[Image], rays: Rays, sphere: Sphere, section: Section, lens: Lens
) -> None:
    """Draw some rows of a section into cover, light and depth."""
    # From the skull end up to the sphere: seen from above, the axis points to the camera.
    axis = sphere.camera_from_sphere[:, 2]
    foot = sphere.centre_mm - section.end_mm * axis
    length = section.end_mm - section.begin_mm
    px_per_mm = lens.focal_px[0] / sphere.distance_mm
    along_axis = rays.dot(axis)
    cover, light, depth = _draw_side(rays, along_axis, foot, axis, section, px_per_mm)
    # The end facing the camera covers the side.
    end_mm = length if foot @ axis + length < 0 else 0.0
    end_cover, end_light, end_depth = _draw_end(
        rays, along_axis, foot + end_mm * axis, axis, section, px_per_mm
    )
    on_end = end_cover > cover
    for whole, end in ((cover, end_cover), (light, end_light), (depth, end_depth)):
        np.copyto(whole, end, where=on_end)
    nearer = (cover > 0.0) & (depth < layers[2])
    np.copyto(layers[0], np.maximum(cover, layers[0]), where=nearer)
    np.copyto(layers[1], light, where=nearer)
    np.copyto(layers[2], depth, where=nearer)


def _draw_side(
    rays: Rays, along_axis: Image, foot: Vector, axis: Vector, section: Section, px_per_mm: float
) -> tuple[Image, Image, Image]:
    """Return coverage, light and depth of the curved side."""
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
    cover = _edge_cover(np.float32(radius) - np.sqrt(distance2), px_per_mm)
    cover *= (height >= 0.0) & (height <= length)
    light: Image = (np.sqrt(across) * chord).astype(np.float32, copy=False)
    light *= np.float32(section.brightness * SIDE_DARKENING / radius)
    light += np.float32(section.brightness * (1 - SIDE_DARKENING))
    return cover, light, depth


def _draw_end(
    rays: Rays, along_axis: Image, centre: Vector, axis: Vector, section: Section, px_per_mm: float
) -> tuple[Image, Image, Image]:
    """Return coverage, light and depth of a flat end."""
    steep = np.where(np.abs(along_axis) < SMALLEST_ACROSS, np.float32(SMALLEST_ACROSS), along_axis)
    depth: Image = (np.float32(centre @ axis) / steep).astype(np.float32, copy=False)
    off2 = depth * depth * rays.squared - 2.0 * depth * rays.dot(centre) + np.float32(centre @ centre)
    cover = _edge_cover(np.float32(section.radius_mm) - np.sqrt(np.maximum(off2, np.float32(0.0))), px_per_mm)
    cover *= depth > 0.0
    light: Image = (np.abs(along_axis) / np.sqrt(rays.squared)).astype(np.float32, copy=False)
    light *= np.float32(section.brightness)
    return cover, light, depth


def _edge_cover(inside_mm: Image, px_per_mm: float) -> Image:
    """Return the coverage of a pixel by how far inside an edge its centre is."""
    cover: Image = np.clip(np.float32(0.5) + inside_mm * np.float32(px_per_mm), 0.0, 1.0)
    return cover
