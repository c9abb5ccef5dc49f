"""Start of a surface registration: a stated pose, landmarks, or a search by the scan alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from procedures.registration.point_registration import Registration, register
from procedures.registration.points import validate_pairs
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.surface.errors import (
    BAD_SURFACE_INPUT,
    LITTLE_COVERAGE,
    SPHERE_UNSEEN,
    TWO_POSES,
)
from procedures.registration.surface.settling import Pose, Settled, settle
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

LANDMARK_SD_MM = 3.0  # of a landmark found with a pointer on skin, each axis (U)
SEEN_SD_MM = 0.5  # of a sphere as the tracker sees it from where the CT has it, each axis (U)
# Of a reading from where landmarks put a sphere. Safety against another reflection taken for a sphere.
# Source: four times what the landmarks' error comes to at the vertex.
NEAR_START_MM = 40.0
FAR_FROM_PAIR_MM = 3.0  # of a sphere that moved visibly, or of a wrong pair (U)
CLEARLY_OTHER = 12.0  # of chi-square, between two ways to pair: one in four hundred
SEARCH_POINTS = 80
SEARCH_SAMPLES = 3000
ORIENTATIONS = 300  # about 35 degrees apart
FIRST_STEPS, NEXT_STEPS = 4, 12
KEPT_FIRST, KEPT_NEXT = 40, 6
OVERLAP = 0.8  # share of the scan that is taken as the head's
SEEN = 0.35  # cosine between a normal and the view, from which a surface is scanned
SAME_TURN_RAD, SAME_PLACE_MM = np.radians(8.0), 8.0  # closer poses are one
CLEARLY_WORSE_MM2 = 0.25  # of the mean square of another pose above that of the best: half a millimetre
SUPER_GOLDEN = 1.533751168755204288118041  # of Alexa 2022, Super-Fibonacci spirals: psi^4 = psi + 4


@dataclass(frozen=True, eq=False)
class Start:
    """Approximate pose robot <- CT, with standard deviations of its turn and of its place at the head."""

    robot_from_ct: Transform
    turn_rad: float
    place_mm: float

    def __post_init__(self) -> None:
        if not (
            np.isfinite([self.turn_rad, self.place_mm]).all() and min(self.turn_rad, self.place_mm) > 0.0
        ):
            raise BAD_SURFACE_INPUT("the error of a start must be positive and finite")

    @classmethod
    def from_landmarks(cls, ct_mm: ArrayLike, robot_mm: ArrayLike, sd_mm: float = LANDMARK_SD_MM) -> Start:
        """Fit at least three landmarks, in the same order in both frames. Raises REG-001, 002, 004."""
        image, physical = validate_pairs(ct_mm, robot_mm)
        fit = fit_rigid(image, physical)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = fit.rotation, fit.translation_mm
        spread_mm = float(np.linalg.svd(image - image.mean(axis=0), compute_uv=False)[1])
        pose = Transform.from_matrix(Frame.ROBOT, Frame.CT, matrix)
        return cls(pose, sd_mm / spread_mm, sd_mm)


@dataclass(frozen=True, eq=False)
class PairedSpheres:
    """Pairs of spheres in CT and room, the pose that landmarks and spheres agree on, and what is left."""

    pairs: tuple[tuple[int, int], ...]
    robot_from_ct: Transform
    residuals_mm: tuple[float, ...]


def pair_spheres(
    start: Start, landmarks_ct_mm: Array, landmarks_mm: Array, spheres_ct_mm: Array, seen_mm: Array
) -> PairedSpheres:
    """Pair every sphere (n, 3) of the CT with a reading (m, 3), all near `start`, by the landmarks it is of.

    Raises SRF-013 if a sphere is not seen, or readings could be exchanged.
    """
    count = len(spheres_ct_mm)
    if not count:
        return PairedSpheres((), start.robot_from_ct, ())
    expected = np.asarray(start.robot_from_ct.apply(spheres_ct_mm))
    near = [np.flatnonzero(np.linalg.norm(seen_mm - one, axis=1) < NEAR_START_MM) for one in expected]
    for number, rows in enumerate(near, start=1):
        if not len(rows):
            raise SPHERE_UNSEEN(
                f"the tracker sees nothing where nose and ears put sphere {number} of the CT",
                limit=f"{NEAR_START_MM:g} mm",
            )
    sizes_mm = np.repeat([LANDMARK_SD_MM, SEEN_SD_MM], [len(landmarks_ct_mm), count])
    covariance = np.eye(3) * sizes_mm[:, None, None] ** 2
    image = np.vstack([landmarks_ct_mm, spheres_ct_mm])
    found: list[tuple[float, tuple[int, ...], Registration]] = []
    for chosen in product(*(one.tolist() for one in near)):
        if len(set(chosen)) == count:
            fit = register(image, np.vstack([landmarks_mm, seen_mm[list(chosen)]]), covariance_mm2=covariance)
            square = float(np.sum((fit.residuals_mm / sizes_mm[:, None]) ** 2))
            found.append((square, chosen, fit))
    found.sort(key=lambda one: one[0])
    if not found or (len(found) > 1 and found[1][0] < found[0][0] + CLEARLY_OTHER):
        raise SPHERE_UNSEEN(
            "it cannot be told which reading of the tracker is which sphere",
            got=f"{len(set(np.concatenate(near).tolist()))} readings for {count}",
        )
    _, best, fit = found[0]
    away_mm = np.linalg.norm(fit.residuals_mm[-count:], axis=1)
    if away_mm.max() > FAR_FROM_PAIR_MM:
        raise SPHERE_UNSEEN(
            f"the tracker sees sphere {int(away_mm.argmax()) + 1} elsewhere than the others put it",
            limit=f"{FAR_FROM_PAIR_MM:g} mm",
            got=f"{away_mm.max():.1f} mm",
        )
    pairs = tuple(enumerate(best))
    return PairedSpheres(pairs, fit.between(Frame.ROBOT, Frame.CT), tuple(away_mm.tolist()))


def pose_of(start: Start) -> Pose:
    """Return the pose CT <- robot of a start."""
    ct_from_robot = start.robot_from_ct.inverse().as_matrix()
    return Pose(ct_from_robot[:3, :3], ct_from_robot[:3, 3])


def find_pose(points_mm: Array, view_mm: Array, surface: Surface, same_head_mm: float) -> Settled:
    """Find the pose by the scan alone. Raises SRF-002 if none fits, SRF-004 if several do.

    Orientations are spread evenly; in each, the parts that the scan's views would see are put together, and
    a trimmed iterative closest point ranks them. The best are settled on the surface. If none has a residual
    below `same_head_mm`, the best is returned for the caller to refuse.
    """
    rows, _ = thin_points(points_mm, SEARCH_POINTS)
    points, view = points_mm[rows], view_mm[rows]
    samples = surface.points_mm[:: max(1, len(surface.points_mm) // SEARCH_SAMPLES)]
    normals = surface.normals[:: max(1, len(surface.points_mm) // SEARCH_SAMPLES)]
    rotations = spread_rotations(ORIENTATIONS)
    looks = np.unique(np.round(view / 50.0), axis=0) * 50.0 - points.mean(axis=0)  # mm: nearly one place
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    seen = np.max(np.einsum("mi,rij,lj->rml", normals, rotations, looks), axis=2) > SEEN
    middle = (seen @ samples) / np.maximum(seen.sum(axis=1), 1)[:, None]
    translations = middle - rotations @ points.mean(axis=0)
    tree = cKDTree(samples)
    for steps, kept in ((FIRST_STEPS, KEPT_FIRST), (NEXT_STEPS, KEPT_NEXT)):
        rotations, translations, residuals_mm = _approach(
            rotations, translations, points, samples, tree, steps
        )
        best = np.argsort(residuals_mm, kind="stable").tolist()
        if kept == KEPT_NEXT:
            best = _distinct(rotations, translations, best, points.mean(axis=0))
        rotations, translations = rotations[best[:kept]], translations[best[:kept]]
    settled = [settle(Pose(*one), points, view, surface) for one in zip(rotations, translations, strict=True)]
    settled = sorted((one for one in settled if one.valid.mean() > 0.5), key=lambda one: one.capped_mm2)
    if not settled:
        raise LITTLE_COVERAGE("no pose puts the scan on the head", got=f"{len(points)} points")
    first = settled[0]
    for other in settled[1:]:
        turn, place = difference(first.pose, other.pose, points.mean(axis=0))
        alike = other.capped_mm2 < first.capped_mm2 + CLEARLY_WORSE_MM2
        if first.sigma_mm < same_head_mm and alike and (turn > SAME_TURN_RAD or place > SAME_PLACE_MM):
            raise TWO_POSES(
                "two poses fit the scan about equally",
                got=f"{first.capped_mm2**0.5:.2f} and {other.capped_mm2**0.5:.2f} mm rms, "
                f"{np.degrees(turn):.0f} deg and {place:.0f} mm apart",
            )
    return first


def difference(one: Pose, other: Pose, at_mm: Array) -> tuple[float, float]:
    """Return turn, rad, and distance, mm, between two poses at a point (3,) of the robot frame."""
    turn = Rotation.from_matrix(one.rotation @ other.rotation.T).magnitude()
    shift = one.apply(at_mm[None]) - other.apply(at_mm[None])
    return float(turn), float(np.linalg.norm(shift))


@cache
def spread_rotations(count: int) -> Array:
    """Return rotations (count, 3, 3) spread evenly (Alexa 2022, super-Fibonacci spirals)."""
    share = (np.arange(count) + 0.5) / count
    alpha = 2.0 * np.pi * (np.arange(count) + 0.5) / 2.0**0.5
    beta = 2.0 * np.pi * (np.arange(count) + 0.5) / SUPER_GOLDEN
    inner, outer = np.sqrt(share), np.sqrt(1.0 - share)
    quaternions = [inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)]
    return np.asarray(Rotation.from_quat(np.column_stack(quaternions)).as_matrix())


def _approach(
    rotations: Array, translations: Array, points: Array, samples: Array, tree: cKDTree, steps: int
) -> tuple[Array, Array, Array]:
    """Step all poses towards the samples by trimmed closest points; return them with their residuals."""
    kept = round(OVERLAP * len(points))
    for step in range(steps + 1):
        placed = points @ np.swapaxes(rotations, 1, 2) + translations[:, None]
        distances, nearest = tree.query(placed)
        used = np.argsort(distances, axis=1, kind="stable")[:, :kept]
        residuals = np.sqrt(np.mean(np.take_along_axis(distances, used, axis=1) ** 2, axis=1))
        if step == steps:
            break
        fit = fit_rigid(points[used], samples[np.take_along_axis(nearest, used, axis=1)])
        rotations, translations = fit.rotation, fit.translation_mm
    return rotations, translations, residuals


def _distinct(rotations: Array, translations: Array, order: list[int], at_mm: Array) -> list[int]:
    """Drop poses that nearly repeat a better one; `order` lists the best first."""
    kept: list[int] = []
    for row in order:
        pose = Pose(rotations[row], translations[row])
        apart = (difference(pose, Pose(rotations[one], translations[one]), at_mm) for one in kept)
        if all(turn > SAME_TURN_RAD or place > SAME_PLACE_MM for turn, place in apart):
            kept.append(row)
    return kept
