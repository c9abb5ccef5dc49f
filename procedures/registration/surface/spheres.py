"""Spheres on screws in the adjustment of a scan: places known in the CT, which the skin's misfit spares.

Each look at a sphere adds three rows, along the axes of the robot frame. What spheres and scan share, the
errors of the arm, is in the same columns for both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from procedures.registration.surface.errors import BAD_SURFACE_INPUT, SPHERE_MOVED
from procedures.registration.surface.misfit import Adjustment, MisfitModel
from procedures.registration.surface.settling import Pose
from ronna_hw.arrays import Array

AXES = 3
# Safety against a screw that moved, or skin that moved against it. Source: as the gate of spheres alone.
MOVED_PROBABILITY = 0.001  # of a sphere so far from where everything else has it


@dataclass(frozen=True, eq=False)
class LookedSpheres:
    """Looks (m,) at spheres: the number of each sphere, its place (m, 3) mm in the CT and in the robot frame.

    `covariance_mm2` (3m, 3m) is the error of CT, seating and look, robot frame; looks at one sphere share the
    first two. Raises SRF-001 for other shapes and numbers that are not finite.
    """

    numbers: NDArray[np.int64]
    image_mm: Array
    physical_mm: Array
    covariance_mm2: Array

    def __post_init__(self) -> None:
        count = len(self.numbers)
        shapes = (count, AXES), (count, AXES), (AXES * count, AXES * count)
        arrays = self.image_mm, self.physical_mm, self.covariance_mm2
        if tuple(map(np.shape, arrays)) != shapes or not all(np.isfinite(one).all() for one in arrays):
            raise BAD_SURFACE_INPUT("the places of spheres, or their errors, do not fit each other")
        error = np.asarray(self.covariance_mm2)
        if count and not (np.allclose(error, error.T) and np.linalg.eigvalsh(error)[0] > 0.0):
            raise BAD_SURFACE_INPUT("the error of the spheres is no covariance", expected="positive definite")

    @classmethod
    def none(cls) -> LookedSpheres:
        """Return no looks: a head without screws."""
        nothing = np.empty((0, AXES))
        return cls(np.empty(0, dtype=np.int64), nothing, nothing, np.empty((0, 0)))

    def residuals_mm(self, pose: Pose) -> Array:
        """Return by how far each look misses its sphere (3m,) at a pose CT <- robot, robot frame."""
        expected = (self.image_mm - pose.translation_mm) @ pose.rotation
        return np.asarray((self.physical_mm - expected).ravel())

    def jacobian(self, pose: Pose, centre_mm: Array) -> Array:
        """Differentiate them by a movement of the looks about a centre in the CT, (3m, 6)."""
        away = np.repeat(pose.apply(self.physical_mm) - centre_mm, AXES, axis=0)
        axes = np.tile(pose.rotation.T, (len(self.numbers), 1))  # of the robot, in the CT
        return np.hstack([np.cross(away, axes), axes])


@dataclass(frozen=True, eq=False)
class SphereAlone:
    """Sphere against the adjustment of everything else: its distance from there, and the chance of it."""

    number: int
    away_mm: float
    rms_mm: float  # of that distance, as expected
    probability: float  # of a distance as unlikely


def judge_spheres(
    model: MisfitModel, jacobian: Array, residuals_mm: Array, spheres: LookedSpheres
) -> tuple[SphereAlone, ...]:
    """Judge each sphere by the adjustment without it, whose rows are the last of all (deletion residuals).

    The hypotheses are weighed by everything else too.
    """
    if not len(spheres.numbers):
        return ()
    last = len(residuals_mm) - AXES * len(spheres.numbers)
    mine = np.eye(len(residuals_mm))[:, last:]
    both = np.column_stack([residuals_mm, mine])
    by_sphere, logs = [], []
    for one in Adjustment.of(model, jacobian).hypotheses:
        half = solve_triangular(one.factor, both, lower=True, check_finite=False)
        left = half.T @ (half - one.rows.pose @ (one.rows.by_pose @ half))  # what no movement explains
        logs.append(one.log_evidence(half[:, 0])[0])
        by_sphere.append((left[1:, 1:], left[1:, 0]))
    weight = np.array(logs)
    return tuple(
        _judge(int(number), np.repeat(spheres.numbers == number, AXES), weight, by_sphere)
        for number in np.unique(spheres.numbers)
    )


def _judge(number: int, rows: Array, weight: Array, parts: list[tuple[Array, Array]]) -> SphereAlone:
    away, covariances, chi_squares, logs = [], [], [], []
    for precision, weighted in parts:
        covariance = np.linalg.inv(precision[np.ix_(rows, rows)])
        found = covariance @ weighted[rows]
        chi_squares.append(float(weighted[rows] @ found))
        logs.append(0.5 * (chi_squares[-1] + np.linalg.slogdet(covariance)[1]))  # of all but the sphere
        away.append(found.reshape(-1, AXES).mean(axis=0))
        covariances.append(np.trace(covariance) * AXES / len(covariance))
    without = weight + np.array(logs)
    shares = np.exp(without - without.max())
    shares /= shares.sum()
    return SphereAlone(
        number,
        away_mm=float(np.linalg.norm(shares @ np.array(away))),
        rms_mm=float(np.sqrt(shares @ np.array(covariances))),
        probability=float(shares @ chdtrc(rows.sum(), np.array(chi_squares))),
    )


def require_unmoved(judged: tuple[SphereAlone, ...]) -> None:
    """Raise SRF-012 if a sphere is not where skin and other spheres have it, naming the least likely."""
    worst = min(judged, key=lambda one: one.probability, default=None)
    if worst is not None and worst.probability < MOVED_PROBABILITY:
        others = "the skin and the other spheres have" if len(judged) > 1 else "the skin has"
        raise SPHERE_MOVED(
            f"sphere {worst.number + 1} is not where {others} it",
            limit=f"about {worst.rms_mm:.2f} mm rms",
            got=f"{worst.away_mm:.2f} mm",
        )
