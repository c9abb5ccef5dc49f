"""Objects between the spheres and the sensor: the edge of a drape or hand, and glare from a lamp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from math import cos, pi, sin
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Canvas, Image
from sim.basler.optics.film import Stain
from sim.basler.optics.lens import Lens
from sim.basler.optics.light import BACKGROUND_ELECTRONS_PER_US, FILM_ELECTRONS_PER_US
from sim.basler.optics.sphere import Sphere
from sim.world.displacements import NOTHING_MOVED, RoomShift

Array = NDArray[np.float64]

GLARE_ELECTRONS_PER_US = 4 * FILM_ELECTRONS_PER_US  # saturates at usual exposures
GLARE_SOFTNESS = 0.04  # standard deviation of its edge, relative to its radius
EDGE_SIGMAS = 4.0  # standard deviations beyond which an edge is invisible
EDGE_STEPS = 400


@dataclass(frozen=True)
class Glare:
    """A lamp reflected by something wet: a bright disc on the sensor."""

    centre_px: tuple[float, float]
    radius_px: float


@dataclass(frozen=True)
class Occluder:
    """A dark object with a straight edge that hides `rim_share` of a sphere's rim from one camera.

    `direction_rad` is the side it enters the image from. `brightness` is relative to the drapes behind it.
    """

    rim_share: float
    direction_rad: float
    brightness: float = 1.0


@dataclass(frozen=True)
class Disturbance:
    """What disturbs one camera's view at one moment; comparable and hashable. Stains by sphere number."""

    stains: tuple[tuple[int, tuple[Stain, ...]], ...] = ()
    occluders: tuple[Occluder, ...] = ()
    glares: tuple[Glare, ...] = ()
    twist_rad: float = field(default=0.0)  # of the camera in its mount, out of the plane of both cameras
    room: RoomShift = NOTHING_MOVED  # displacement of the spheres

    def stains_of(self, number: int) -> tuple[Stain, ...]:
        """The stains of a sphere."""
        return tuple(stain for each, stains in self.stains if each == number for stain in stains)


CLEAR = Disturbance()


def occlude(canvas: Canvas, occluder: Occluder, sphere: Sphere, lens: Lens, sigma_px: float) -> None:
    """Hide a sphere's rim behind an edge that is as sharp as the sphere."""
    outline = lens.project(sphere.outline_mm())
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    radius = float(np.ptp(outline, axis=0).mean()) / 2
    towards = np.array([cos(occluder.direction_rad), sin(occluder.direction_rad)])
    # A chord at the cosine of half its arc cuts off that arc.
    edge = radius * cos(pi * occluder.rim_share)
    x = (canvas.area.x + np.arange(canvas.area.width) - middle[0]) * (towards[0] / sigma_px)
    y = (canvas.area.y + np.arange(canvas.area.height) - middle[1]) * (towards[1] / sigma_px)
    x -= edge / sigma_px
    cover = _edge(y.astype(np.float32)[:, None] + x.astype(np.float32)[None, :])
    dark = np.float32(occluder.brightness * BACKGROUND_ELECTRONS_PER_US)
    canvas.light[:] += cover * (dark - canvas.light)


def shine(canvas: Canvas, glare: Glare) -> None:
    """Add the light of a glare."""
    sigma = max(GLARE_SOFTNESS * glare.radius_px, 1.0)
    margin = int(glare.radius_px + EDGE_SIGMAS * sigma) + 1
    x, y = (round(value) for value in glare.centre_px)
    part = Area(x - margin, y - margin, 2 * margin + 1, 2 * margin + 1).common(canvas.area)
    if part.empty:
        return
    columns = part.x + np.arange(part.width) - glare.centre_px[0]
    rows = part.y + np.arange(part.height) - glare.centre_px[1]
    beyond = (np.hypot(columns[None, :], rows[:, None]) - glare.radius_px) / sigma
    canvas.part(part)[:] += np.float32(GLARE_ELECTRONS_PER_US) * (np.float32(1.0) - _edge(beyond))


def nearest_to_axis(spheres: Sequence[Sphere]) -> Sphere | None:
    """The sphere that the camera is aimed at; None without any."""
    return min(spheres, key=lambda each: float(np.hypot(*each.centre_mm[:2])), default=None)


def _edge(sigmas: Array | Image) -> Image:
    """Coverage by an object with a blurred edge, by the distance from the edge in its sigmas."""
    cover: Image = (sigmas > 0.0).astype(np.float32)
    soft = np.abs(sigmas) < EDGE_SIGMAS  # a thin band: the table is slow
    cover[soft] = np.interp(sigmas[soft], *_edge_table())
    return cover


@cache
def _edge_table() -> tuple[Array, Array]:
    at = np.linspace(-EDGE_SIGMAS, EDGE_SIGMAS, EDGE_STEPS + 1)
    cover = np.array([NormalDist().cdf(each) for each in at])
    cover[0], cover[-1] = 0.0, 1.0
    return at, cover
