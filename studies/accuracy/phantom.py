"""Phantom of the accuracy studies: a head with free spheres or the x-shaped frame, and trajectories.

The thesis does not publish its phantom. This one is drawn once and is the same in every study. Targets are in
the middle of an ellipsoid head of normal size, trajectories are tilted. Positions are in front of the arm, as
for a phantom on a table. Its frame, named CT: origin in the middle of the head, z to the vertex, mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.strategies.trajectory import Trajectory
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from studies.heads import HALF_AXES_MM

PATIENT = 2  # of the correspondence study, whose head this is
FREE_SPHERES = 5
AROUND_RAD = 2.0 * math.pi / FREE_SPHERES  # from one to the next, about the vertex: three are on one side
ABOVE_RAD = math.radians(20.0)  # seen from the middle of the head
STANDOFF_MM = 16.0  # of a free sphere's centre from the skin
FRAME_STANDOFF_MM = 26.0  # of the frame's plane
FRAME_TILT_RAD = math.radians(25.0)  # of the frame's foot from the vertex
PHANTOM_KEY, PLACE_KEY = 5, 6  # of the random numbers
DRAWN_ONCE = 2018
INNER_SHARE = 0.6  # default: targets in the middle of the head
PLACE_MM = (620.0, 0.0, 140.0)
PLACE_SPREAD_MM = (60.0, 100.0, 40.0)
PLACE_TURN_RAD = (math.radians(8.0), math.radians(8.0), math.radians(30.0))
ATTEMPTS = 100_000


class Markers(StrEnum):
    """Types of registration markers on the phantom."""

    FREE = "free"
    FRAME = "xframe"


@dataclass(frozen=True)
class Tilts:
    """Ranges of tilt from the vertical, and of azimuth from the x axis."""

    tilts_deg: tuple[float, float]
    sides_deg: tuple[float, float]


USUAL_TILTS = Tilts((10.0, 45.0), (0.0, 360.0))
ALIKE = Tilts((25.0, 30.0), (-30.0, 30.0))


@dataclass(frozen=True)
class Phantom:
    """Sphere centres (n, 3) in the order of use, and trajectories."""

    spheres_mm: Array
    trajectories: tuple[Trajectory, ...]


def counts_of(markers: Markers) -> tuple[int, ...]:
    """Return the sphere counts available for a registration. The frame has only four spheres."""
    return (3, 4, 5) if markers is Markers.FREE else (3, 4)


def spheres_mm(markers: Markers) -> Array:
    """Return the sphere centres in the phantom frame, mm."""
    if markers is Markers.FREE:
        around = AROUND_RAD * np.arange(FREE_SPHERES)
        level, up = math.cos(ABOVE_RAD), np.full(FREE_SPHERES, math.sin(ABOVE_RAD))
        directions = np.stack([level * np.cos(around), level * np.sin(around), up], axis=1)
        sites = np.array([_skin_along(np.zeros(3), direction) for direction in directions])
        return np.asarray(sites + STANDOFF_MM * _outward_normals(sites))
    turn = Rotation.from_rotvec([FRAME_TILT_RAD, 0.0, 0.0])
    outward = turn.apply([0.0, 0.0, 1.0])
    foot = _skin_along(np.zeros(3), outward)
    return np.asarray(turn.apply(SPHERE_CENTRES_MM) + foot + FRAME_STANDOFF_MM * _outward_normals(foot))


def draw_phantom(
    markers: Markers,
    depths_mm: tuple[float, float],
    targets: int,
    inner_share: float = INNER_SHARE,
    tilts: Tilts = USUAL_TILTS,
) -> Phantom:
    """Draw the phantom from a fixed seed, with targets in a range of depths below the skin.

    `inner_share` of the head's half axes bounds their positions.
    """
    random = np.random.default_rng([DRAWN_ONCE, PHANTOM_KEY, *(round(depth) for depth in depths_mm)])
    half = np.array(HALF_AXES_MM[PATIENT])
    drawn: list[Trajectory] = []
    for _ in range(ATTEMPTS):
        target = random.uniform(-1.0, 1.0, 3) * inner_share * half
        tilt, azimuth = (
            random.uniform(*np.radians(tilts.tilts_deg)),
            random.uniform(*np.radians(tilts.sides_deg)),
        )
        outward = np.array(
            [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]
        )
        if np.linalg.norm(target / half) < inner_share:
            entry = _skin_along(target, outward)
            if depths_mm[0] <= np.linalg.norm(entry - target) <= depths_mm[1]:
                drawn.append(Trajectory(f"T{len(drawn) + 1}", _as_point(entry), _as_point(target)))
        if len(drawn) == targets:
            break
    return Phantom(spheres_mm(markers), tuple(drawn))


def phantom_pose(number: int, turn_share: float = 1.0) -> Transform:
    """Return the phantom's pose, ROBOT <- CT, at position `number`, turned by that share of the usual."""
    random = np.random.default_rng([DRAWN_ONCE, PLACE_KEY, number])
    shift = np.array(PLACE_MM) + random.uniform(-1.0, 1.0, 3) * PLACE_SPREAD_MM
    turn = Rotation.from_rotvec(turn_share * random.uniform(-1.0, 1.0, 3) * PLACE_TURN_RAD)
    return Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_components(shift, turn))


def _outward_normals(points_mm: Array) -> Array:
    normal = points_mm / np.square(HALF_AXES_MM[PATIENT])
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def _skin_along(start_mm: Array, direction: Array) -> Array:
    """Intersect a ray from inside the head with the skin."""
    half = np.array(HALF_AXES_MM[PATIENT])
    along, away = direction / half, start_mm / half
    square, middle = along @ along, along @ away
    length = (-middle + math.sqrt(middle**2 - square * (away @ away - 1.0))) / square
    return np.asarray(start_mm + length * direction)


def _as_point(vector: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in vector)
    return x, y, z
