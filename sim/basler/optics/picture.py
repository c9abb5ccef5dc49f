"""Light on one camera's sensor: spheres drawn from far to near, depth blur and disturbances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import cos, pi, sin
from statistics import NormalDist

import numpy as np

from sim.basler.optics.canvas import (
    LARGEST_SIGMA_PX,
    Area,
    Image,
    Lens,
    PixelCanvas,
    blur,
    bounds_of,
    row_bands,
    spread_px,
)
from sim.basler.optics.film import Film, Grain, Stain
from sim.basler.optics.laser_light import add_core, add_glow, project_runs
from sim.basler.optics.laser_line import LineRun
from sim.basler.optics.sensor import BACKGROUND_ELECTRONS_PER_US, FILM_ELECTRONS_PER_US, Lighting
from sim.basler.optics.speckle import Speckle
from sim.basler.optics.sphere import BodyImage, DrawnSphere, draw_sphere, draw_stalk, stalk_outline_mm
from sim.world.displacements import NOTHING_MOVED, RoomShift
from sim.world.rigid import Array
from sim.world.scene.model import CameraTruth

FILM_TO_BACKGROUND = FILM_ELECTRONS_PER_US / BACKGROUND_ELECTRONS_PER_US
GLARE_ELECTRONS_PER_US = 4 * FILM_ELECTRONS_PER_US  # saturates at usual exposures
GLARE_SOFTNESS = 0.04  # standard deviation of its edge, relative to its radius
EDGE_SIGMAS = 4.0  # standard deviations beyond which an edge is invisible
EDGE_STEPS = 400

MARGIN_PX = spread_px(LARGEST_SIGMA_PX)  # drawn around the area of interest as input for the blur
NEAREST_MM = 60.0  # nothing closer is drawn: the lens is longer than that


@dataclass(frozen=True)
class Glare:
    """Reflection of a lamp on a wet surface: a bright disc on the sensor."""

    centre_px: tuple[float, float]
    radius_px: float


@dataclass(frozen=True)
class Occluder:
    """A dark, straight-edged object hiding `rim_share` of a sphere's rim from one camera.

    `direction_rad` is the side it enters the image from. `brightness` is relative to the drapes behind it.
    """

    rim_share: float
    direction_rad: float
    brightness: float = 1.0


@dataclass(frozen=True)
class PictureDisturbance:
    """Disturbances of one camera's view at one moment, hashable, with stains keyed by sphere number."""

    stains: tuple[tuple[int, tuple[Stain, ...]], ...] = ()
    occluders: tuple[Occluder, ...] = ()
    glares: tuple[Glare, ...] = ()
    twist_rad: float = 0.0  # rotation of the camera in its mount, out of the plane of both cameras
    room: RoomShift = NOTHING_MOVED  # displacement of the spheres
    lamp_share: float = 0.0  # light of a room lamp on the skin, relative to that of film
    hand_mm: float | None = None  # height of a hand in the projector's line over the skin
    line_dark: bool = False  # the projector gives no light although it is switched on

    def stains_of(self, number: int) -> tuple[Stain, ...]:
        """Return the stains of a sphere."""
        return tuple(stain for each, stains in self.stains if each == number for stain in stains)


CLEAR = PictureDisturbance()


class LensOptics:
    """Lens, lighting and cached sphere grains of one camera."""

    def __init__(self, camera: CameraTruth, seed: int) -> None:
        self.lens = Lens.from_camera(camera)
        self._lighting = Lighting(seed, camera.serial, camera.sensor_px)
        self._seed, self._serial = seed, camera.serial
        self._grains: dict[int, Grain] = {}

    def light_on(
        self,
        area: Area,
        spheres: Sequence[DrawnSphere],
        disturbance: PictureDisturbance = CLEAR,
        line: Sequence[LineRun] = (),
        moment: int = 0,
    ) -> Image:
        """Return the light on an area of the sensor, (height, width) in electrons per microsecond.

        `line` are the runs of the projected line, `moment` a number of the place of head and camera.
        """
        around = area.expand(MARGIN_PX) if spheres else area
        canvas = PixelCanvas(around, self._lighting.on_background(around))
        if disturbance.lamp_share:
            canvas.light[:] *= 1.0 + disturbance.lamp_share * FILM_TO_BACKGROUND
        drawn_line = project_runs(line, self.lens, area)
        add_glow(canvas, drawn_line)
        for sphere in sorted(spheres, key=lambda each: -each.distance_mm):
            self._draw(canvas, sphere, disturbance)
        aimed_at = nearest_to_axis([each for each in spheres if _is_drawable(each)])
        if aimed_at is not None:
            sigma_px = self.lens.blur_sigma_px(float(aimed_at.centre_mm[2]))
            for occluder in disturbance.occluders:
                occlude(canvas, occluder, aimed_at, self.lens, sigma_px)
        if drawn_line:  # in front of all that is drawn so far, as its runs are what the camera sees
            add_core(canvas, drawn_line, Speckle(self._seed, self._serial, moment))
        for glare in disturbance.glares:
            add_glare(canvas, glare)
        return canvas.part(area)

    def _draw(self, canvas: PixelCanvas, sphere: DrawnSphere, disturbance: PictureDisturbance) -> None:
        if not _is_drawable(sphere):
            return
        sigma_px = self.lens.blur_sigma_px(float(sphere.centre_mm[2]))
        sphere_area = bounds_of(self.lens, sphere.outline_mm()).intersect(canvas.area)
        stalk_area = bounds_of(self.lens, stalk_outline_mm(sphere)).intersect(canvas.area)
        parts = [part for part in (sphere_area, stalk_area) if not part.empty]
        if not parts:
            return
        patch_area = _enclosing_area(parts).expand(spread_px(sigma_px)).intersect(canvas.area)
        patch = canvas.part(patch_area)
        drawn = PixelCanvas(patch_area, patch.copy())
        self._paint(drawn, sphere, self._make_film(sphere, disturbance), sphere_area, stalk_area)
        patch[:] = blur(drawn.light, sigma_px)

    def _paint(
        self, canvas: PixelCanvas, sphere: DrawnSphere, film: Film, sphere_area: Area, stalk_area: Area
    ) -> None:
        # Light falls off with the square of the distance; full strength at the focus distance.
        strength = np.float32((self.lens.focus_mm / sphere.distance_mm) ** 2)
        stalk = self._draw_stalk_part(sphere, stalk_area, strength)
        if stalk is not None:
            _composite(canvas.part(stalk_area), stalk.cover, stalk.light)
        if sphere_area.empty:
            return
        drawn = draw_sphere(sphere, self.lens, sphere_area, film)
        self._illuminate(drawn, strength)
        _composite(canvas.part(sphere_area), drawn.cover, drawn.light)
        both = sphere_area.intersect(stalk_area)
        if stalk is None or both.empty:
            return
        stalk_part, drawn_part = (
            PixelCanvas(stalk_area, stalk.depth_mm),
            PixelCanvas(sphere_area, drawn.depth_mm),
        )
        in_front = stalk_part.part(both) < drawn_part.part(both)
        in_front &= np.isfinite(drawn_part.part(both))
        cover = PixelCanvas(stalk_area, stalk.cover).part(both) * in_front
        _composite(canvas.part(both), cover, PixelCanvas(stalk_area, stalk.light).part(both))

    def _draw_stalk_part(self, sphere: DrawnSphere, area: Area, strength: np.float32) -> BodyImage | None:
        """Draw the stalk within an area, or return None if the area is empty."""
        if area.empty:
            return None
        image = draw_stalk(sphere, self.lens, area)
        self._illuminate(image, strength)
        return image

    def _illuminate(self, image: BodyImage, strength: np.float32) -> None:
        """Convert brightness to light, in place."""
        light = image.light
        light *= self._lighting.on_film(image.area)
        light *= strength

    def _make_film(self, sphere: DrawnSphere, disturbance: PictureDisturbance) -> Film:
        if sphere.number not in self._grains:
            self._grains[sphere.number] = Grain(self._seed, sphere.number)
        grain = self._grains[sphere.number]
        to_camera = -sphere.camera_from_sphere.T @ sphere.centre_mm / sphere.distance_mm
        stains = [each for each in disturbance.stains_of(sphere.number) if each.may_be_visible(to_camera)]
        return Film(grain, sphere.radius_mm, stains)


def occlude(
    canvas: PixelCanvas, occluder: Occluder, sphere: DrawnSphere, lens: Lens, sigma_px: float
) -> None:
    """Hide a sphere's rim behind an edge that is as blurred as the sphere itself."""
    outline = lens.project(sphere.outline_mm())
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    radius = float(np.ptp(outline, axis=0).mean()) / 2
    towards = np.array([cos(occluder.direction_rad), sin(occluder.direction_rad)])
    # A chord at the cosine of half its arc cuts off that arc.
    edge = radius * cos(pi * occluder.rim_share)
    x = (canvas.area.x + np.arange(canvas.area.width) - middle[0]) * (towards[0] / sigma_px)
    y = (canvas.area.y + np.arange(canvas.area.height) - middle[1]) * (towards[1] / sigma_px)
    x -= edge / sigma_px
    cover = _soft_edge(y.astype(np.float32)[:, None] + x.astype(np.float32)[None, :])
    dark = np.float32(occluder.brightness * BACKGROUND_ELECTRONS_PER_US)
    canvas.light[:] += cover * (dark - canvas.light)


def add_glare(canvas: PixelCanvas, glare: Glare) -> None:
    """Add a glare to the light."""
    sigma = max(GLARE_SOFTNESS * glare.radius_px, 1.0)
    margin = int(glare.radius_px + EDGE_SIGMAS * sigma) + 1
    x, y = (round(value) for value in glare.centre_px)
    part = Area(x - margin, y - margin, 2 * margin + 1, 2 * margin + 1).intersect(canvas.area)
    if part.empty:
        return
    columns = part.x + np.arange(part.width) - glare.centre_px[0]
    rows = part.y + np.arange(part.height) - glare.centre_px[1]
    distance_sigmas = (np.hypot(columns[None, :], rows[:, None]) - glare.radius_px) / sigma
    canvas.part(part)[:] += np.float32(GLARE_ELECTRONS_PER_US) * (
        np.float32(1.0) - _soft_edge(distance_sigmas)
    )


def nearest_to_axis(spheres: Sequence[DrawnSphere]) -> DrawnSphere | None:
    """Return the sphere nearest to the optical axis, or None if there are no spheres."""
    return min(spheres, key=lambda each: float(np.hypot(*each.centre_mm[:2])), default=None)


def _soft_edge(sigmas: Array | Image) -> Image:
    """Return the coverage near a blurred edge, given the signed distance inside it in sigmas."""
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


def _is_drawable(sphere: DrawnSphere) -> bool:
    return bool(sphere.centre_mm[2] - sphere.radius_mm >= NEAREST_MM)


def _composite(behind: Image, cover: Image, light: Image) -> None:
    """Composite light over the background, in place."""
    for rows in row_bands(*behind.shape):
        change = light[rows] - behind[rows]
        change *= cover[rows]
        behind[rows] += change


def _enclosing_area(areas: Sequence[Area]) -> Area:
    left, top = min(area.x for area in areas), min(area.y for area in areas)
    right = max(area.x + area.width for area in areas)
    bottom = max(area.y + area.height for area in areas)
    return Area(left, top, right - left, bottom - top)
