"""Motion of known points, detected from a second measurement in the same frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.correspondence import MatchStatus
from procedures.registration.error_theory import FreGate
from procedures.registration.matching import match
from procedures.registration.point_registration import Registration, register
from procedures.registration.rigid_fit import fit_rigid
from ronna_hw.arrays import Array

GATE_CONFIDENCE = 0.999  # of the chi-square gate: one false alarm in a thousand moves

LEAST_POINTS = 3
NEAR_MM = 8.0  # a point this close to a recorded one is that point: spheres are 20 mm and more apart
SIGMA_MM = 0.15  # per axis, of averaged tracker points, where they must be recognised by their layout


@dataclass(frozen=True)
class RigidMove:
    """Rigid motion after <- before, with the errors of both measurements."""

    fit: Registration

    @property
    def way_mm(self) -> float:
        """Displacement of the points' centroid."""
        middle = self.fit.image_mm.mean(axis=0)
        return math.dist(self.fit.transform.apply(middle), middle)

    @property
    def turn_rad(self) -> float:
        """Angle of rotation."""
        return float(self.fit.transform.rotation.magnitude())

    @property
    def rms_mm(self) -> float:
        """Rms displacement of the points due to the motion."""
        displacements = np.asarray(self.fit.transform.apply(self.fit.image_mm)) - self.fit.image_mm
        return math.sqrt(float(np.square(displacements).sum(axis=1).mean()))

    @property
    def gate(self) -> FreGate:
        """Chi-square gate, by the covariances, on whether the points moved as one body."""
        return self.fit.gate(confidence=GATE_CONFIDENCE)

    def error_mm(self, place_mm: ArrayLike) -> float:
        """Predict the rms error of the motion at a position (3,) mm occupied before it."""
        return float(self.fit.predict_tre_mm(np.reshape(np.asarray(place_mm, dtype=float), (1, 3)))[0])


def fit_rigid_move(before_mm: ArrayLike, after_mm: ArrayLike, covariance_mm2: ArrayLike) -> RigidMove:
    """Fit a rigid motion to paired points (n, 3), n >= 3.

    `covariance_mm2` (n, 3, 3) is the sum over both measurements of each point. Raises REG-001 to REG-006, and
    REG-009 for a mirrored set.
    """
    fit = register(before_mm, after_mm, covariance_mm2=covariance_mm2)
    fit.require_rotation()  # the residuals are the caller's to judge, by `gate`
    return RigidMove(fit)


@dataclass(frozen=True)
class PointShift:
    """Mean displacement (3,) mm and rms displacement of points, and how many there are."""

    mean_mm: Array
    rms_mm: float
    points: int

    @classmethod
    def of(cls, displacements_mm: Array) -> PointShift:
        """Average displacements (n, 3)."""
        rms_mm = float(np.sqrt((displacements_mm**2).sum(axis=1).mean()))
        return cls(displacements_mm.mean(axis=0), rms_mm, len(displacements_mm))


def measure_shift(recorded_mm: ArrayLike, seen_mm: ArrayLike) -> PointShift | None:
    """Measure the shift of points (n, 3) from unordered new readings (m, 3) that may include other points.

    None when fewer than three of them are seen, or when their identity is not clear.
    """
    recorded, seen = _rows(recorded_mm), _rows(seen_mm)
    pairs = identify_points(recorded, seen)
    if pairs is None:
        return None
    rows, columns = (list(side) for side in zip(*pairs, strict=True))
    fit = fit_rigid(recorded[rows], seen[columns])
    return PointShift.of(recorded[rows] @ fit.rotation.T + fit.translation_mm - recorded[rows])


def lone_displacement_mm(recorded_mm: ArrayLike, seen_mm: ArrayLike, limit_mm: float) -> float | None:
    """Return the displacement in mm of a lone moved point, or None unless at least three others stayed put.

    Shapes like in `measure_shift`.
    """
    recorded, seen = _rows(recorded_mm), _rows(seen_mm)
    pairs = identify_points(recorded, seen) or ()
    moved_mm = [float(np.linalg.norm(seen[column] - recorded[row])) for row, column in pairs]
    *others, farthest = sorted(moved_mm) or [0.0]
    is_alone = len(others) >= LEAST_POINTS and others[-1] < limit_mm <= farthest
    return farthest if is_alone else None


def identify_points(recorded_mm: ArrayLike, seen_mm: ArrayLike) -> list[tuple[int, int]] | None:
    """Find points (n, 3) in an unordered new reading (m, 3); return pairs of row indices.

    Matched to the nearest, or by their layout if too few match or the match is not clear. None when fewer
    than three are seen, or when their identity is not clear.
    """
    recorded, seen = _rows(recorded_mm), _rows(seen_mm)
    if min(len(recorded), len(seen)) < LEAST_POINTS:
        return None
    apart = np.linalg.norm(recorded[:, None] - seen[None], axis=2)
    pairs = [(row, int(apart[row].argmin())) for row in range(len(recorded)) if apart[row].min() < NEAR_MM]
    if len(pairs) >= LEAST_POINTS and len({column for _, column in pairs}) == len(pairs):
        return pairs
    found = match(recorded, seen, sigma_image_mm=SIGMA_MM, sigma_physical_mm=SIGMA_MM)
    if found.status is not MatchStatus.UNIQUE:
        return None
    return [(int(row), int(column)) for row, column in found.pairs]


def _rows(points_mm: ArrayLike) -> Array:
    return np.asarray(points_mm, dtype=float).reshape(-1, 3)
