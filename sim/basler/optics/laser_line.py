"""A projected line on the bodies before the head, and the runs of it that a camera sees.

Rays of the fan meet the nearest body; a camera sees a point that no body hides. The width of the line on a
surface follows from its inclination to the sheet of light.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import pi, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.gige_vision import PIXEL_PITCH_UM
from sim.basler.optics.canvas import EFFECTIVE_F_NUMBER, Area, Lens
from sim.world.head_surface.smooth_field import smooth_field
from sim.world.head_surface.surface import HeadSurface
from sim.world.rigid import Array, Matrix, Vector, Vectors, apply, inverse
from sim.world.scene.line_projector import LineProjector

RAYS = 180  # of the fan: 0.3 mm apart on the skin; a chord of a nose's tip is 2 um off its arc
VIEW_MM = 80.0  # before and behind the projector's focus: what lies there may be in a picture
VIEW_STEPS = 5
VIEW_MARGIN_PX = 200  # around the area: light that spreads into it
FURTHEST_MM = 600.0
LIFT_MM = 0.8  # over the surface, from where it is asked whether anything hides a point from a camera
# Places on the way to the camera where skin would hide a point; what is thinner than their spacing may not.
SIGHT_MM = np.array([0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0, 25.0, 30.0, 36.0, 43.0, 51.0, 60.0, 70.0])
SIGHT_EVERY = 2  # ray: shadows end within 0.3 mm of their place
JUMP_MM = 1.5  # between neighbouring rays: another part of the surface
SIGMAS_OF_WIDTH = 4.0  # of a Gaussian beam between the places of 1/e²
LEAST_INCLINATION = 0.05  # sine between surface and sheet: a line that runs along the sheet has no width

QUANTUM_EFFICIENCY = 0.35  # of a CMV2000 NIR at 850 nm (U)
PHOTON_J_NM = 1.98645e-16  # energy of a photon times its wavelength in nm

GLOSS_MM = 0.8  # length over which pores and sweat tilt the surface (U)
GLOSS_TILT_RAD = radians(7.0)  # standard deviation of that tilt (U)
GLOSS_WIDTH_RAD = radians(4.0)  # of a reflection (U)


@dataclass(frozen=True)
class Finish:
    """Reflection of a body's surface: share of the light that returns, and where it leaves again.

    Light returns from the surface itself, from just below it (`near_mm`, one standard deviation), or from the
    depth (`far_mm`, decay length). `gloss` is the brightness of a mirror-like spot, relative to the diffuse.
    """

    albedo: float
    near_share: float = 0.0
    far_share: float = 0.0
    near_mm: float = 0.35
    far_mm: float = 2.0
    gloss: float = 0.0

    @property
    def surface_share(self) -> float:
        """Share of the returning light that leaves where it came in."""
        return 1.0 - self.near_share - self.far_share


# Skin at 850 nm: reduced scattering of 1.5 and absorption of 0.03 per mm (U) let light out after some mm.
SKIN = Finish(albedo=0.6, near_share=0.35, far_share=0.35, gloss=25.0)
FILM = Finish(albedo=0.5)  # beads return light to the projector, away from the cameras: the rest is diffuse
HAIR = Finish(albedo=0.06)  # strands before the skin: thin, dark and in all directions


@dataclass(frozen=True)
class Body:
    """Surface in the CT frame that reflects the line."""

    surface: HeadSurface
    finish: Finish


@dataclass(frozen=True)
class Hair:
    """Hair over the skin: whether strands hide points (n, 3), and how thick they lie there."""

    hides: Callable[[Vectors], NDArray[np.bool_]]
    thickness_mm: Callable[[Vectors], Array]


@dataclass(frozen=True)
class LineRun:
    """Unbroken part of the line in the camera frame, along which brightness may still vary.

    `across_mm` (n, 3) is the displacement on the surface by one standard deviation of the sheet; `light` (n,)
    what a pixel in the middle would get from a line without blur and scattering, electrons per microsecond;
    `gloss` (n,) what mirror-like spots add to it.
    """

    points_mm: Vectors
    across_mm: Vectors
    light: Array
    gloss: Array
    finish: Finish


def trace_line(
    projector: LineProjector,
    ct_from_projector: Matrix,
    camera_from_ct: Matrix,
    picture: tuple[Lens, Area],
    bodies: Sequence[Body],
    hair: Hair | None = None,
    seed: int = 0,
) -> tuple[LineRun, ...]:
    """Return the runs of the line on these bodies, the skin first, that a camera sees in its area.

    `seed` is that of the skin's gloss.
    """
    angle = np.linspace(-0.5, 0.5, RAYS) * radians(projector.fan_deg)
    fan = np.column_stack([np.sin(angle), np.zeros(RAYS), np.cos(angle)])
    directions = fan @ ct_from_projector[:3, :3].T
    start = ct_from_projector[:3, 3]
    reach_mm = projector.focus_mm + np.linspace(-VIEW_MM, VIEW_MM, VIEW_STEPS)
    places = start + reach_mm[:, None, None] * directions
    directions = directions[_is_in_view(picture, apply(camera_from_ct, places.reshape(-1, 3)))]
    if not len(directions):
        return ()
    away_mm, hit = cast_nearest(bodies, start, directions)
    lit = np.flatnonzero(hit >= 0)
    if not len(lit):
        return ()
    sheet = ct_from_projector[:3, 1]
    eye = inverse(camera_from_ct)[:3, 3]
    runs: list[LineRun] = []
    for number, body in enumerate(bodies):
        on = lit[hit[lit] == number]
        if not len(on):
            continue
        points = start + away_mm[on, None] * directions[on]
        normals = body.surface.normals(points)
        line = _SurfaceLine(points, normals, directions[on], away_mm[on], on)
        hidden = hair.hides(points) if hair is not None and number == 0 else np.zeros(len(on), dtype=bool)
        seen = _is_seen(bodies, eye, line)
        layers = [(line, body.finish, seen & ~hidden)]
        if hair is not None and hidden.any():  # as well seen as the skin under it
            layers.append((line.raised(hair.thickness_mm(points), seed), HAIR, seen & hidden))
        for layer, finish, bright in layers:
            runs.extend(_runs(layer, finish, bright, projector, sheet, eye, camera_from_ct, seed))
    return tuple(runs)


def _is_in_view(picture: tuple[Lens, Area], places_mm: Vectors) -> NDArray[np.bool_]:
    """Return whether the camera may see a ray (n,), given several places of each: (places * n, 3)."""
    lens, area = picture
    wide = area.expand(VIEW_MARGIN_PX)
    x, y = lens.project(places_mm).T
    inside = (x >= wide.x) & (x < wide.x + wide.width) & (y >= wide.y) & (y < wide.y + wide.height)
    return np.asarray(inside.reshape(VIEW_STEPS, -1).any(axis=0))


def cast_nearest(
    bodies: Sequence[Body], start: Vectors, directions: Vectors, furthest_mm: float = FURTHEST_MM
) -> tuple[Array, NDArray[np.intp]]:
    """Return distance and number of the body (n,) that each ray meets first; NaN and -1 without one."""
    origins = np.broadcast_to(start, directions.shape)
    hits = np.array([body.surface.cast(origins, directions, furthest_mm) for body in bodies])
    away = np.where(np.isnan(hits), np.inf, hits)
    nearest = away.argmin(axis=0)
    away_mm = away[nearest, np.arange(len(directions))]
    met = np.isfinite(away_mm)
    return np.where(met, away_mm, np.nan), np.where(met, nearest, -1)


@dataclass(frozen=True)
class _SurfaceLine:
    """Lit points (n, 3) on one body in the CT frame; `ray` is their number in the fan."""

    points: Vectors
    normals: Vectors
    directions: Vectors
    away_mm: Array
    ray: NDArray[np.intp]

    def raised(self, thickness_mm: Array, seed: int) -> _SurfaceLine:
        """Return the points where strands over the skin stop the light."""
        height = thickness_mm * _uniform(seed, "strand", self.points)
        facing = np.maximum(-(self.directions * self.normals).sum(axis=1), LEAST_INCLINATION)
        back = np.minimum(height / facing, 0.5 * self.away_mm)
        points = self.points - back[:, None] * self.directions
        return _SurfaceLine(points, self.normals, self.directions, self.away_mm - back, self.ray)


def _is_seen(bodies: Sequence[Body], eye: Vector, line: _SurfaceLine) -> NDArray[np.bool_]:
    """Return whether nothing is between points and camera.

    The skin is asked at places along the sight, at once: rays that leave a surface would take many steps.
    """
    start = line.points + LIFT_MM * line.normals
    sight = eye - start
    length = np.linalg.norm(sight, axis=1)
    sight = sight / length[:, None]
    faces = (sight * line.normals).sum(axis=1) > 0.0
    skin, *others = bodies
    asked = np.arange(0, len(sight), SIGHT_EVERY)
    places = start[asked] + SIGHT_MM[:, None, None] * sight[asked]
    inside = (skin.surface.distance_mm(places.reshape(-1, 3)) < 0.0).reshape(len(SIGHT_MM), -1)
    nearest = np.minimum(np.rint(np.arange(len(sight)) / SIGHT_EVERY).astype(np.intp), len(asked) - 1)
    covered: NDArray[np.bool_] = np.any(inside, axis=0)[nearest]
    if others:
        covered |= cast_nearest(others, start, sight, float(length.max()))[1] >= 0
    return np.asarray(faces & ~covered)


def _runs(
    line: _SurfaceLine,
    finish: Finish,
    seen: NDArray[np.bool_],
    projector: LineProjector,
    sheet: Vector,
    eye: Vector,
    camera_from_ct: Matrix,
    seed: int,
) -> Iterator[LineRun]:
    facing = np.maximum(-(line.directions * line.normals).sum(axis=1), 0.0)
    tangent = sheet - (line.normals @ sheet)[:, None] * line.normals
    inclination = np.maximum((tangent * tangent).sum(axis=1), LEAST_INCLINATION**2)
    sigma_mm = beam_sigma_mm(projector, line.away_mm)
    across = sigma_mm[:, None] * tangent / inclination[:, None] @ camera_from_ct[:3, :3].T
    light = finish.albedo * facing * _electrons_per_us(projector, line.away_mm, sigma_mm)
    gloss = light * finish.gloss * _mirrored(line, eye, seed) if finish.gloss else np.zeros(len(light))
    points = apply(camera_from_ct, line.points)
    index = np.flatnonzero(seen)
    jumps = (np.diff(line.ray[index]) > 1) | (np.abs(np.diff(line.away_mm[index])) > JUMP_MM)
    for part in np.split(index, np.flatnonzero(jumps) + 1):
        if len(part) > 1:
            yield LineRun(points[part], across[part], light[part], gloss[part], finish)


def beam_sigma_mm(projector: LineProjector, away_mm: Array) -> Array:
    """Return the standard deviation of the sheet's thickness at distances from the lens: a Gaussian beam."""
    waist_mm = projector.width_mm / 2.0
    rayleigh_mm = pi * waist_mm**2 / (projector.wavelength_nm * 1e-6)
    spread = np.sqrt(1.0 + np.square((away_mm - projector.focus_mm) / rayleigh_mm))
    return np.asarray(projector.width_mm / SIGMAS_OF_WIDTH * spread)


def _electrons_per_us(projector: LineProjector, away_mm: Array, sigma_mm: Array) -> Array:
    """Return the light of a white diffuse surface across the beam, in the middle of the line."""
    per_mm_W = projector.power_mW * 1e-3 / (radians(projector.fan_deg) * away_mm)
    irradiance_W_mm2 = per_mm_W / (sqrt(2.0 * pi) * sigma_mm)
    pixel_W = irradiance_W_mm2 / (4.0 * EFFECTIVE_F_NUMBER**2) * (PIXEL_PITCH_UM * 1e-3) ** 2
    photons_per_us = pixel_W * projector.wavelength_nm / PHOTON_J_NM * 1e-6
    return np.asarray(photons_per_us * QUANTUM_EFFICIENCY)


def _mirrored(line: _SurfaceLine, eye: Vector, seed: int) -> Array:
    """Return how well pores and sweat mirror the line into a camera (n,), 1 at the brightest."""
    sight = eye - line.points
    half = sight / np.linalg.norm(sight, axis=1, keepdims=True) - line.directions
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    fields = (smooth_field(seed, f"gloss {axis}", GLOSS_MM).at(line.points) for axis in "xyz")
    tilted = line.normals + GLOSS_TILT_RAD * np.column_stack(list(fields))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    off_rad = np.arccos(np.clip((tilted * half).sum(axis=1), -1.0, 1.0))
    return np.asarray(np.exp(-0.5 * np.square(off_rad / GLOSS_WIDTH_RAD)))


def _uniform(seed: int, name: str, points: Vectors) -> Array:
    """Return a random number (n,) between 0 and 1 for each strand's place."""
    return np.asarray(0.5 + 0.5 * np.sin(4.0 * smooth_field(seed, name, GLOSS_MM).at(points)))
