"""Start of a surface registration: a stated pose, or landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.point_registration import Registration, register
from procedures.registration.points import validate_pairs
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.surface.errors import BAD_SURFACE_INPUT, SPHERE_UNSEEN
from procedures.registration.surface.settling import Pose
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

LANDMARK_SD_MM = 4.0  # per axis, of a landmark touched on skin and found in the CT (U)
SEEN_SD_MM = 0.5  # of a sphere as the tracker sees it from where the CT has it, each axis (U)
# Of a reading from where landmarks put a sphere. Safety against another reflection taken for a sphere.
# Source: four times what the landmarks' error comes to at the vertex.
NEAR_START_MM = 40.0
FAR_FROM_PAIR_MM = 3.0  # of a sphere that moved visibly, or of a wrong pair (U)
CLEARLY_OTHER = 12.0  # of chi-square, between two ways to pair: one in four hundred


@dataclass(frozen=True, eq=False)
class Start:
    """Approximate pose robot <- CT, with standard deviations of its turn and of its place at the head.

    `landmarks_ct_mm` (n, 3) are those that it was fitted to, if any; `place_mm` is then theirs, per axis.
    """

    robot_from_ct: Transform
    turn_rad: float
    place_mm: float
    landmarks_ct_mm: Array | None = None

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
        return cls(pose, sd_mm / spread_mm, sd_mm, image)


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
    for number, readings in enumerate(near, start=1):
        if not len(readings):
            raise SPHERE_UNSEEN(
                f"the tracker sees nothing where nose and ears put sphere {number} of the CT",
                limit=f"{NEAR_START_MM:g} mm",
            )
    sizes_mm = np.repeat([start.place_mm, SEEN_SD_MM], [len(landmarks_ct_mm), count])
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


def pose_of(robot_from_ct: Transform) -> Pose:
    """Return the pose CT <- robot for a pose robot <- CT."""
    ct_from_robot = robot_from_ct.inverse().as_matrix()
    return Pose(ct_from_robot[:3, :3], ct_from_robot[:3, 3])
