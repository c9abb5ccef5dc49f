"""Scan of a head by a line projector between two cameras, from looks around it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.surface.scan import Numbers, SurfaceScan
from procedures.registration.surface.starts import Start
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import Frame, Transform
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import hair_mm, hidden_by_hair
from studies.surface.conditions import (
    COVERAGES,
    START_MM,
    START_TURN_RAD,
    Coverage,
    Direction,
    Draw,
    Hair,
    Skin,
    unit_directions,
)
from studies.surface.heads import HeadInCt
from studies.surface.second_judged_skins import Blur, foresee_blur
from studies.surface.skins import displace, shift_third

LINES, POINTS = 10, 80  # of a look: a line each, and points along it
AWAY_MM = 400.0  # projector to the middle of the head
HALF_FIELD = 0.3  # tangent: the lines sweep over the whole head
AIM_BELOW_MM = 30.0  # of the cranium's centre: between brain and face
CAMERAS_RAD = float(np.radians(27.5))  # of each camera from the projector, as the stereo head's 55 degrees
LEAST_COSINE = 0.2  # of light on skin, and of skin to a camera
OCCLUDED_MM = 1.0  # a camera's ray that ends before by more sees another part of the head
ACROSS_SHARE = 0.4  # of the noise across the ray, relative to along
LOST_SHARE = 0.2  # points without a line found
STRAY_SHARE, STRAY_MM = 0.01, 5.0  # specular spots and double reflections
HAIR_SEEN_SHARE = 0.25  # of the points on hair; no line is found on the others
HAT_MM, HAT_SHARE = (5.0, 15.0), 0.97
PLACE_MM = 400.0  # of the head from the robot's base, standard deviation of each coordinate


@dataclass(frozen=True, eq=False)
class Trial:
    """One scan with its start, the true pose robot <- CT, and the slices of the CT if they are thick."""

    scan: SurfaceScan
    start: Start
    truth: Transform
    slices: Blur | None


class Lit(NamedTuple):
    """Lit points that both cameras see: places and those of their projectors (n, 3), looks and lines (n,)."""

    points_mm: Array
    projectors_mm: Array
    look: Numbers
    line: Numbers


def draw_trial(
    in_ct: HeadInCt, coverage: Coverage, skin: Skin, draw: Draw, random: np.random.Generator, *, shifted: bool
) -> Trial:
    """Scan a head whose skin is displaced, from an approximately known pose.

    `shifted` displaces a third of the scanned skin by 1 mm besides.
    """
    scanned = COVERAGES[coverage]
    head = _with_hair(in_ct.head, scanned.hair, random)
    points, projector, look, line = _find_visible(in_ct.head, scanned.looks)
    normals = head.normals(points)
    slices = foresee_blur(random) if skin is Skin.BLUR else None
    moved = displace(skin, head, points, draw, random)
    if shifted:
        moved = moved + shift_third(points, random)
    hidden = hidden_by_hair(head, points)
    moved = moved + np.where(hidden, random.uniform(size=len(points)) * hair_mm(head, points), 0.0)
    chance = random.uniform(size=len(points))
    kept = chance > np.where(hidden, 1.0 - HAIR_SEEN_SHARE, LOST_SHARE)
    ray = points - projector
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    stray = np.where(
        random.uniform(size=len(points)) < STRAY_SHARE, STRAY_MM * random.normal(size=len(points)), 0.0
    )
    noise = _noise_covariance(ray, draw.noise_mm)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(noise), random.normal(size=points.shape))
    measured = points + moved[:, None] * normals + errors + stray[:, None] * ray
    truth = Transform(
        Frame.ROBOT,
        Frame.CT,
        RigidTransform.from_components(random.normal(size=3) * PLACE_MM, Rotation.random(rng=random)),
    )
    turn = truth.rotation_matrix
    scan = SurfaceScan(
        points_mm=truth.apply(measured[kept]),
        covariance_mm2=turn @ noise[kept] @ turn.T,
        look=look[kept],
        line=line[kept],
        view_mm=truth.apply(projector[kept]),
    )
    return Trial(scan, _draw_start(truth, random), truth, slices)


def _with_hair(head: ParametricHead, hair: Hair, random: np.random.Generator) -> ParametricHead:
    if hair is Hair.AS_DRAWN:
        return head
    update = {"hair_mm": 0.0, "hair_share": 0.0}
    if hair is Hair.HAT:
        update = {"hair_mm": float(random.uniform(*HAT_MM)), "hair_share": HAT_SHARE}
    return ParametricHead(head.centre_ct_mm, head.semi_axes_mm, head.face.model_copy(update=update))


@lru_cache(maxsize=len(COVERAGES))
def _find_visible(head: ParametricHead, looks: tuple[Direction, ...]) -> Lit:
    """Return the lit points that both cameras see."""
    aim = np.asarray(head.centre_ct_mm) - [0.0, 0.0, AIM_BELOW_MM]
    parts = []
    for number, towards in enumerate(unit_directions(looks)):
        across = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[2]) > 0.9 else [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        along = np.cross(towards, across)
        projector = aim + AWAY_MM * towards
        sweep, place = np.meshgrid(
            np.linspace(-HALF_FIELD, HALF_FIELD, LINES),
            np.linspace(-HALF_FIELD, HALF_FIELD, POINTS),
            indexing="ij",
        )
        rays = sweep.reshape(-1, 1) * across + place.reshape(-1, 1) * along - towards
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        reach = head.cast(np.broadcast_to(projector, rays.shape), rays, 2.0 * AWAY_MM)
        hit = np.isfinite(reach)
        points = projector + reach[hit, None] * rays[hit]
        line = np.repeat(np.arange(LINES), POINTS)[hit] + LINES * number
        seen = _is_seen(head, points, projector)
        for angle in (-CAMERAS_RAD, CAMERAS_RAD):
            seen &= _is_seen(head, points, aim + AWAY_MM * (np.cos(angle) * towards + np.sin(angle) * across))
        count = int(seen.sum())
        parts.append((points[seen], np.tile(projector, (count, 1)), np.full(count, number), line[seen]))
    return Lit(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def _is_seen(head: ParametricHead, points: Array, place: Array) -> Mask:
    """Return whether points (n, 3) of the skin are seen from a place, and not at too flat an angle."""
    rays = points - place
    away = np.linalg.norm(rays, axis=1)
    rays /= away[:, None]
    facing = -np.einsum("ni,ni->n", rays, head.normals(points)) > LEAST_COSINE
    reach = head.cast(np.broadcast_to(place, rays.shape), rays, 2.0 * AWAY_MM)
    return np.asarray(facing & (reach > away - OCCLUDED_MM))


def _noise_covariance(ray: Array, noise_mm: float) -> Array:
    """Return covariances (n, 3, 3) with the noise along the rays, less across."""
    along = ray[:, :, None] * ray[:, None, :]
    return np.asarray(noise_mm**2 * (along + ACROSS_SHARE**2 * (np.eye(3) - along)))


def _draw_start(truth: Transform, random: np.random.Generator) -> Start:
    """Draw a start by the tracker: turned and displaced about the middle of the head."""
    turn = Rotation.from_rotvec(random.normal(size=3) * START_TURN_RAD / np.sqrt(3.0))
    shift = RigidTransform.from_components(random.normal(size=3) * START_MM / np.sqrt(3.0), turn)
    return Start(Transform(Frame.ROBOT, Frame.CT, truth.rigid * shift), START_TURN_RAD, START_MM)
