"""A head with nose, brows, cheeks and ears by signed distances, and scans of it with a known misfit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.starts import Start
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import Frame, Transform

LOWEST_MM = -120.0
FRONT_AND_EARS = ((0.0, -1.0, 0.2), (1.0, -0.6, 0.2), (-1.0, -0.6, 0.2), (0.0, -0.7, 1.0))
FACE = ((0.0, -1.0, 0.0),)
VAULT = ((0.0, -0.6, 1.0), (0.0, 0.0, 1.0), (0.5, -0.5, 1.0), (-0.5, -0.5, 1.0))
TARGETS_MM = np.array([[-20.0, -20.0, -20.0], [20.0, 10.0, 25.0], [0.0, 40.0, 0.0]])
NOISE_MM = 0.05


def ellipsoid(points: Array, centre: tuple[float, ...], axes: tuple[float, ...]) -> Array:
    """Signed distance to an ellipsoid, exact near it."""
    scaled = (points - centre) / axes
    size = np.linalg.norm(scaled, axis=-1)
    return np.asarray(size * (size - 1.0) / np.maximum(np.linalg.norm(scaled / axes, axis=-1), 1e-9))


def blend(one: Array, other: Array, width_mm: float) -> Array:
    """Smooth union."""
    share = np.clip(0.5 + 0.5 * (other - one) / width_mm, 0.0, 1.0)
    return np.asarray(other * (1.0 - share) + one * share - width_mm * share * (1.0 - share))


class MadeHead:
    """Head in patient coordinates: x to the left, y to the back, z up. `side_mm` adds a bump."""

    voxel_mm = np.eye(3)

    def __init__(self, seed: int = 0, *, side_mm: float = 0.0, ball: bool = False) -> None:
        draw = np.random.default_rng(seed).uniform
        self.axes = (draw(70, 80), draw(90, 100), draw(72, 82))
        self.nose, self.ear, self.jaw = draw(0.8, 1.25), draw(0.8, 1.2), draw(0.9, 1.1)
        self.side_mm, self.ball = side_mm, ball
        directions = np.random.default_rng(1).normal(size=(3500, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.array([0.0, 0.0, -30.0]) + 250.0 * directions
        points, hit = self.cast(origins, -directions)
        self.points_mm = points[hit & (points[:, 2] > LOWEST_MM)]
        self.normals = self.find_normals(self.points_mm)

    def distance_mm(self, points: Array) -> Array:
        """Signed distance, positive outside."""
        width, length, _ = self.axes
        if self.ball:
            return np.asarray(np.linalg.norm(points, axis=-1) - 80.0)
        found = ellipsoid(points, (0, 0, 0), self.axes)
        found = blend(found, ellipsoid(points, (0, -25, -62), (56 * self.jaw, 58, 62)), 18)
        found = blend(found, ellipsoid(points, (0, 6 - length, -48), (9 * self.nose, 20 * self.nose, 22)), 9)
        for side in (-1, 1):
            found = blend(found, ellipsoid(points, (side * 26, 16 - length, -20), (24, 12, 8)), 10)
            found = blend(found, ellipsoid(points, (side * 38, 26 - length, -58), (18, 14, 14)), 14)
            ear = (7 * self.ear, 17 * self.ear, 30 * self.ear)
            found = blend(found, ellipsoid(points, (side * (width + 4), 12, -42), ear), 5)
        if self.side_mm:
            found = blend(found, ellipsoid(points, (45, -length + 20, 25), (20, 20 + self.side_mm, 20)), 10)
        return found

    def find_normals(self, points: Array) -> Array:
        """Outward normals by differences."""
        steps = 0.05 * np.eye(3)
        slope = np.stack(
            [self.distance_mm(points + one) - self.distance_mm(points - one) for one in steps], -1
        )
        return np.asarray(slope / np.linalg.norm(slope, axis=-1, keepdims=True))

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Distances, normals, and that all are valid."""
        return (
            self.distance_mm(points_ct_mm),
            self.find_normals(points_ct_mm),
            np.ones(len(points_ct_mm), bool),
        )

    def cast(self, origins: Array, directions: Array) -> tuple[Array, Mask]:
        """Return the points at which rays meet the head."""
        along = np.zeros(len(origins))
        for _ in range(70):
            along = np.minimum(along + 0.7 * self.distance_mm(origins + along[:, None] * directions), 450.0)
        places = origins + along[:, None] * directions
        return places, np.abs(self.distance_mm(places)) < 0.02


@dataclass(frozen=True, eq=False)
class MadeScan:
    """A scan, its true pose robot <- CT, and a start near it."""

    scan: SurfaceScan
    truth: Transform
    start: Start

    def errors_mm(self, robot_from_ct: Transform, targets: Array = TARGETS_MM) -> Array:
        """Errors (n, 3) at targets."""
        return np.asarray(robot_from_ct.apply(targets) - self.truth.apply(targets))


def make_scan(
    head: MadeHead,
    seed: int,
    *,
    views: tuple[tuple[float, float, float], ...] = FRONT_AND_EARS,
    count: int = 170,
    misfit_mm: float = 0.2,
    length_mm: float = 20.0,
    offset_mm: float = 0.0,
    outwards: Callable[[Array], Array] | None = None,
    moved: Callable[[Array, Array], Array] | None = None,
) -> MadeScan:
    """Scan a head whose skin misses that in the CT by a smooth random field, which no hypothesis has."""
    random = np.random.default_rng(seed)
    points, looks, origins = [], [], []
    for number, direction in enumerate(np.asarray(views)):
        away = direction / np.linalg.norm(direction)
        across = np.cross(away, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across) if np.linalg.norm(across) > 0.1 else 1.0
        beside = random.uniform(-110, 110, (2 * count // len(views) + 40, 2))
        if np.linalg.norm(across) < 0.1:
            across = np.array([1.0, 0.0, 0.0])
        start = beside[:, :1] * across + beside[:, 1:] * np.cross(away, across) + 300.0 * away + [0, 0, -20]
        found, hit = head.cast(start, np.tile(-away, (len(start), 1)))
        hit &= (found[:, 2] > LOWEST_MM + 5.0) & (head.find_normals(found) @ away > 0.35)
        points.append(found[hit])
        looks.append(np.full(hit.sum(), number))
        origins.append(np.tile(400.0 * away, (hit.sum(), 1)))
    places, look, view = np.vstack(points), np.concatenate(looks), np.vstack(origins)
    kept = np.sort(random.permutation(len(places))[:count])
    places, look, view = places[kept], look[kept], view[kept]
    correlation = np.exp(-0.5 * (cdist(places, places) / length_mm) ** 2) + 1e-7 * np.eye(len(places))
    field = misfit_mm * np.linalg.cholesky(correlation) @ random.normal(size=len(places)) + offset_mm
    field = field if outwards is None else field + outwards(places)
    measured = (
        places + head.find_normals(places) * field[:, None] + NOISE_MM * random.normal(size=places.shape)
    )
    measured = measured if moved is None else moved(measured, look)
    truth = RigidTransform.from_components(random.normal(size=3) * 300.0, Rotation.random(rng=random))
    nearby = RigidTransform.from_components(
        random.normal(size=3) * 3.0, Rotation.from_rotvec(random.normal(size=3) * 0.03)
    )
    scan = SurfaceScan(
        truth.apply(measured),
        np.tile(np.eye(3) * NOISE_MM**2, (len(places), 1, 1)),
        look,
        look,
        truth.apply(view),
    )
    robot_from_ct = Transform(Frame.ROBOT, Frame.CT, truth)
    return MadeScan(scan, robot_from_ct, Start(Transform(Frame.ROBOT, Frame.CT, truth * nearby), 0.06, 8.0))


@pytest.fixture(scope="session")
def heads() -> list[MadeHead]:
    return [MadeHead(seed) for seed in range(2)]


@pytest.fixture(scope="session")
def made_head() -> type[MadeHead]:
    return MadeHead


@pytest.fixture(scope="session")
def scan_of() -> Callable[..., MadeScan]:
    return make_scan
