"""What holds a sphere: post, flange and base on the skull, all darker than the film.

A stalk runs from below into the sphere. Seen from the side its flange covers a part of the sphere's rim;
seen from above it lies behind the sphere and its outer edge touches the image of the rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Image, Rays
from sim.basler.optics.lens import Lens
from sim.basler.optics.sphere import Sphere

Vector = NDArray[np.float64]

SIDE_DARKENING = 0.6  # a cylinder's edge sends this much less light than its middle
OUTLINE_POINTS = 16


@dataclass(frozen=True)
class Section:
    """A cylinder on the axis of the stalk; distances from the sphere's centre towards the skull."""

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
    """Per pixel of `area`: the share covered, the light sent, the depth (infinite where nothing is)."""

    area: Area
    cover: Image
    light: Image
    depth_mm: Image


def outline_mm(sphere: Sphere) -> Vector:
    """Points (n, 3) that enclose the stalk of a sphere."""
    across, over, post = sphere.camera_from_sphere.T
    angle = np.linspace(0.0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)[:, None]
    circle = np.cos(angle) * across + np.sin(angle) * over
    rings = [
        sphere.centre_mm - along * post + section.radius_mm * circle
        for section in SECTIONS
        for along in (section.begin_mm, section.end_mm)
    ]
    return np.concatenate(rings)


def image_of(sphere: Sphere, lens: Lens, area: Area) -> StalkImage:
    """Draw the stalk of a sphere of unit brightness over `area`."""
    shape = (area.height, area.width)
    image = StalkImage(
        area, np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    )
    rays = Rays(lens, area)
    for section in SECTIONS:
        _add(image, sphere, section, lens, rays)
    return image


def _add(image: StalkImage, sphere: Sphere, section: Section, lens: Lens, rays: Rays) -> None:
    # From the skull end up to the sphere: the axis then points to the camera when seen from above.
    axis = sphere.camera_from_sphere[:, 2]
    foot = sphere.centre_mm - section.end_mm * axis
    length = section.end_mm - section.begin_mm
    along_axis = rays.dot(axis)
    foot_along = float(foot @ axis)
    across = rays.squared - along_axis * along_axis  # squared part of the ray across the axis
    np.maximum(across, np.float32(1e-6), out=across)
    towards = rays.dot(foot - foot_along * axis)  # the axis, seen along each ray
    gap = float(foot @ foot) - foot_along**2
    # Squared distance between ray and axis, and the half chord that the ray has in the cylinder.
    distance2 = np.maximum(np.float32(gap) - towards * towards / across, np.float32(0.0))
    chord = np.sqrt(np.maximum(np.float32(section.radius_mm**2) - distance2, np.float32(0.0)) / across)
    depth = towards / across - chord
    height = depth * along_axis - np.float32(foot_along)
    px_per_mm = lens.focal_px[0] / sphere.distance_mm
    side = np.float32(section.radius_mm) - np.sqrt(distance2)
    cover = np.clip(0.5 + side * px_per_mm, 0.0, 1.0) * ((height >= 0.0) & (height <= length))
    light = section.brightness * (
        1 - SIDE_DARKENING + SIDE_DARKENING * np.sqrt(across) * chord / section.radius_mm
    )
    # The end that faces the camera: its plane, cut to the disc.
    end = length if foot_along + length < 0 else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        end_depth = np.float32(foot_along + end) / along_axis
        centre = foot + end * axis
        off2 = end_depth * end_depth * rays.squared - 2 * end_depth * rays.dot(centre) + centre @ centre
        disc = np.clip(0.5 + (section.radius_mm - np.sqrt(np.maximum(off2, 0.0))) * px_per_mm, 0.0, 1.0)
        tilt = np.abs(along_axis) / np.sqrt(rays.squared)
    on_end = (disc > cover) & np.isfinite(end_depth) & (end_depth > 0)
    cover = np.where(on_end, disc, cover)
    depth = np.where(on_end, end_depth, depth)
    light = np.where(on_end, section.brightness * tilt, light)
    nearer = (cover > 0) & (depth < image.depth_mm)
    np.copyto(image.cover, np.maximum(cover, image.cover), where=nearer, casting="same_kind")
    np.copyto(image.light, light, where=nearer, casting="same_kind")
    np.copyto(image.depth_mm, depth, where=nearer, casting="same_kind")
