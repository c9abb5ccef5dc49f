"""Error to expect of a scan before it is made, and the poses that lower it most.

The covariance is that of the registration. How large the misfit will be is not known before the scan, so the
hypotheses are weighed by what is usual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.points import validate_points, validate_targets
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.surface.errors import BAD_SURFACE_INPUT, LITTLE_COVERAGE
from procedures.registration.surface.misfit import BESIDE_SPHERES, UNMODELLED, Misfit, MisfitModel, Roughness
from procedures.registration.surface.prediction import SurfacePrediction
from procedures.registration.surface.surface import LEVEL_SD_MM
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

USUAL_SIZES = {0.1: 0.2, 0.2: 0.4, 0.4: 0.4}  # mm, and how often: 0.3 mm rms of skin that nothing pressed (U)
USUAL_LENGTHS_MM = {Roughness.ROUGH: 40.0, Roughness.SMOOTH: 20.0}
USUAL = {
    Misfit(size, length, kind): share / len(USUAL_LENGTHS_MM)
    for kind, length in USUAL_LENGTHS_MM.items()
    for size, share in USUAL_SIZES.items()
}
NOISE_MM = 0.05  # of a scanned point (U)
PLANNED_POINTS = 150  # of an expected error: more hardly change it, nor the order of the looks
FEWEST_POINTS = 12
WORTH_MM_PER_S = 0.0005  # 0.005 mm at the targets for a look of ten seconds (U)


def expect_error(
    points_ct_mm: ArrayLike,
    normals_ct: ArrayLike,
    targets_ct_mm: ArrayLike,
    *,
    misfits: dict[Misfit, float] | None = None,
) -> list[SurfacePrediction]:
    """Expect the error at targets (m, 3) registered by points (n, 3) with outward normals (n, 3).

    `misfits` are hypotheses with their probabilities, by default usual ones. Raises REG-001, SRF-001,
    SRF-002.
    """
    points, normals = validate_points(points_ct_mm, "surface"), validate_points(normals_ct, "normal")
    targets = validate_targets(targets_ct_mm)
    if len(points) != len(normals):
        raise BAD_SURFACE_INPUT(f"{len(points)} points but {len(normals)} normals")
    rows = thin_points(points)
    expected = ExpectedPose.of(points[rows], normals[rows], misfits)
    return [expected.at(one) for one in targets]


@dataclass(frozen=True, eq=False)
class Station:
    """Look that could be taken: points (n, 3) of the surface that it shows, their normals, its duration."""

    points_ct_mm: Array
    normals_ct: Array
    seconds: float


@dataclass(frozen=True)
class StationChoice:
    """Looks to take, in order of their gain, and the rms error at the targets after each of them."""

    stations: tuple[int, ...]
    rms_mm: tuple[float, ...]


def choose_stations(
    candidates: Sequence[Station],
    targets_ct_mm: ArrayLike,
    *,
    worth_mm_per_s: float = WORTH_MM_PER_S,
) -> StationChoice:
    """Choose looks one by one, each the one that lowers the error at the targets most for its time.

    Ends when no further look lowers it by `worth_mm_per_s`. Raises REG-001, and
    SRF-002 if no look shows enough of the surface.
    """
    targets = validate_targets(targets_ct_mm)
    chosen: list[int] = []
    errors: list[float] = []
    looks: list[Station] = []
    now = float("inf")
    while len(chosen) < len(candidates):
        open_now = [one for one in range(len(candidates)) if one not in chosen]
        after = {one: _rms_of([*looks, candidates[one]], targets) for one in open_now}
        if not np.isfinite(now):
            best = min(after, key=lambda one: after[one])
        else:
            best = max(after, key=lambda one: (now - after[one]) / candidates[one].seconds)
            if now - after[best] < worth_mm_per_s * candidates[best].seconds:
                break
        if not np.isfinite(after[best]):
            raise LITTLE_COVERAGE("no look shows enough of the surface", limit=f"{FEWEST_POINTS} points")
        chosen.append(best)
        looks.append(candidates[best])
        now = after[best]
        errors.append(now)
    return StationChoice(tuple(chosen), tuple(errors))


def _rms_of(stations: Sequence[Station], targets: Array) -> float:
    """Return the rms error over all targets; infinite if the looks show too little."""
    points = np.concatenate([one.points_ct_mm for one in stations])
    if len(points) < FEWEST_POINTS:
        return float("inf")
    normals = np.concatenate([one.normals_ct for one in stations])
    rows = thin_points(points, PLANNED_POINTS)
    if len(rows) < FEWEST_POINTS:
        return float("inf")
    return float(np.sqrt(ExpectedPose.of(points[rows], normals[rows]).mean_square_mm2(targets)))


@dataclass(frozen=True, eq=False)
class ExpectedPose:
    """Errors of a pose before the scan: covariances (h, 6, 6) about a centre, weights of the hypotheses."""

    weights: Array
    covariances: Array
    centre_mm: Array

    @classmethod
    def of(
        cls,
        points: Array,
        normals: Array,
        misfits: dict[Misfit, float] | None = None,
        noise_mm: float = NOISE_MM,
        shared_mm: Array | None = None,
    ) -> Self:
        """Expect the pose by points (n, 3) with outward normals, as `expect_error`. Raises SRF-002."""
        if len(points) < FEWEST_POINTS:
            raise LITTLE_COVERAGE(
                f"{format_count(len(points), 'point')} of the surface", limit=f"{FEWEST_POINTS}"
            )
        centre, misfits = points.mean(axis=0), misfits or USUAL
        shared = np.zeros((len(points), 0)) if shared_mm is None else shared_mm
        noise_mm2, level_mm = np.full(len(points), noise_mm**2), np.full((len(points), 1), LEVEL_SD_MM)
        model = MisfitModel.of(points, normals, noise_mm2, shared, level_mm, tuple(misfits))
        jacobian = np.hstack([np.cross(points - centre, normals), normals])
        weights = np.array(list(misfits.values()))
        covariances = UNMODELLED**2 * model.adjust(jacobian, np.zeros(len(points))).covariances
        return cls(weights / weights.sum(), covariances, centre)

    def with_spheres(self, spheres_mm: Array, sd_mm: float) -> Self:
        """Add spheres (..., n, 3), CT mm, measured with this standard deviation per axis, to the skin."""
        slopes = pose_jacobian(spheres_mm, self.centre_mm)
        known = np.einsum("...nij,...nik->...jk", slopes, slopes) / sd_mm**2
        weights = np.concatenate([chance * self.weights for _, chance in BESIDE_SPHERES])
        by_skin = np.concatenate(
            [(excess / UNMODELLED) ** 2 * self.covariances for excess, _ in BESIDE_SPHERES]
        )
        informed = np.linalg.inv(by_skin) + known[..., None, :, :]
        return replace(self, weights=weights, covariances=np.linalg.inv(informed))

    def mean_square_mm2(self, targets_mm: Array) -> Array:
        """Return the mean square error over targets (m, 3), (...)."""
        slopes = pose_jacobian(targets_mm, self.centre_mm)
        return np.asarray(
            np.einsum("mij,...hjk,mik,h->...", slopes, self.covariances, slopes, self.weights)
            / len(targets_mm)
        )

    def at(self, target_mm: Array) -> SurfacePrediction:
        """Return the error at a target (3,)."""
        slope = pose_jacobian(target_mm, self.centre_mm)
        zero = np.zeros((len(self.weights), 3))
        return SurfacePrediction(self.weights, zero, slope @ self.covariances @ slope.T)
