"""Misfit between a scanned surface and that in the CT: correlated errors, their sizes unknown.

Skin is not where the CT showed it: it was pressed, taped, swollen. Neighbouring points share that error, so
five hundred points say far less about the pose than their noise suggests. Each hypothesis states a size and a
length of the misfit. The pose follows by generalised least squares with its covariance, and the scan tells
the hypotheses apart by restricted likelihood (Patterson and Thompson 1971), the pose integrated out. The
result is the mixture, so that an uncertain size widens the limits. Matérn kernels (Stein 1999, Interpolation
of Spatial Data): the squared exponential, smooth without end, is far too confident here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from ronna_hw.arrays import Array

POSE = 6  # unknowns of a pose
OFFSET_SD_MM = 0.1  # of the surface's level in the CT, the same everywhere (U)
LEAST_NOISE_MM = 0.03  # of a surface by grey values, from point to point (U)
NOTHING_KNOWN = np.empty((0, 0))
POSE_SD = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])  # rad and mm: a turn that nothing shows stays finite


class Roughness(StrEnum):
    """Kinds of correlation by distance: Matérn's with smoothness one half and three halves."""

    ROUGH = "Matérn 1/2"
    SMOOTH = "Matérn 3/2"


_CORRELATIONS: dict[Roughness, Callable[[Array], Array]] = {
    Roughness.ROUGH: lambda ratio: np.exp(-ratio),
    Roughness.SMOOTH: lambda ratio: (1.0 + 3.0**0.5 * ratio) * np.exp(-(3.0**0.5) * ratio),
}


@dataclass(frozen=True)
class Misfit:
    """Hypothesis: standard deviation along the normal, correlation length, and kind of correlation."""

    size_mm: float
    length_mm: float
    roughness: Roughness

    def covariance_mm2(self, distances_mm: Array) -> Array:
        """Return the covariance of points at these distances from each other."""
        return np.asarray(self.size_mm**2 * _CORRELATIONS[self.roughness](distances_mm / self.length_mm))


SIZES_MM = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
LENGTHS_MM = {Roughness.ROUGH: (15.0, 40.0, 100.0), Roughness.SMOOTH: (10.0, 20.0, 40.0)}
MISFITS = tuple(
    Misfit(size_mm, length_mm, roughness)
    for roughness, lengths_mm in LENGTHS_MM.items()
    for length_mm, size_mm in product(lengths_mm, SIZES_MM)
)


@dataclass(frozen=True, eq=False)
class PoseMixture:
    """Small movement of a scan as a mixture: weights (h,), shifts (h, 6) and covariances (h, 6, 6).

    Rotation vector about a centre, rad, and translation, mm. `gains` (h, 6, n) is the effect of each residual
    on the shift, without sign; `log_likelihoods` (h,) are restricted ones.
    """

    weights: Array
    shifts: Array
    covariances: Array
    gains: Array
    log_likelihoods: Array

    @property
    def mean(self) -> Array:
        """Expected shift (6,)."""
        return np.asarray(self.weights @ self.shifts)


@dataclass(frozen=True, eq=False)
class MisfitModel:
    """Covariance of the residuals of n points under each hypothesis, factored once.

    A rigid movement leaves the distances of the points, so the factors serve all its steps.
    """

    misfits: tuple[Misfit, ...]
    log_prior: Array  # (h,)
    factors: tuple[tuple[Array, bool], ...]
    log_determinants: Array  # (h,)

    @classmethod
    def of(
        cls,
        points_mm: Array,
        noise_mm2: Array,
        shared_mm: Array,
        misfits: Sequence[Misfit] = MISFITS,
        prior: Array | None = None,
        known_mm2: Array = NOTHING_KNOWN,
    ) -> Self:
        """Factor the covariances for points (n, 3) with noise (n,) along the normals.

        `shared_mm` (n, k) is the displacement along the normals by further errors of one standard deviation.
        All hypotheses are equally likely without a `prior` (h,). `known_mm2` (q, q) is the covariance of
        further residuals, the last rows of `shared_mm`, which have nothing of the misfit.
        """
        count, distances_mm = len(points_mm), cdist(points_mm, points_mm)
        common = shared_mm @ shared_mm.T
        common[:count, :count] += OFFSET_SD_MM**2
        common[np.diag_indices(count)] += noise_mm2 + LEAST_NOISE_MM**2
        common[count:, count:] += known_mm2
        kinds = {(one.roughness, one.length_mm): Misfit(1.0, one.length_mm, one.roughness) for one in misfits}
        unit = {kind: one.covariance_mm2(distances_mm) for kind, one in kinds.items()}
        factors = []
        for one in misfits:
            covariance = common.copy()
            covariance[:count, :count] += one.size_mm**2 * unit[one.roughness, one.length_mm]
            factors.append(cho_factor(covariance, lower=True, check_finite=False))
        logs = np.array([2.0 * np.log(np.diagonal(factor)).sum() for factor, _ in factors])
        equal = np.full(len(misfits), 1.0 / len(misfits))
        return cls(tuple(misfits), np.log(equal if prior is None else prior), tuple(factors), logs)

    def adjust(self, jacobian: Array, residuals_mm: Array) -> PoseMixture:
        """Find the shift that removes residuals (n,), which grow by `jacobian` (n, 6) per unit of shift."""
        both = np.column_stack([jacobian, residuals_mm])
        shifts, covariances, gains, likelihoods = [], [], [], []
        for factor, log_determinant in zip(self.factors, self.log_determinants, strict=True):
            weighted = cho_solve(factor, both, check_finite=False)
            normal = jacobian.T @ weighted[:, :POSE] + np.diag(POSE_SD**-2)
            covariance = np.linalg.inv(normal)
            shift = -covariance @ (jacobian.T @ weighted[:, POSE])
            chi_square = residuals_mm @ (weighted[:, POSE] + weighted[:, :POSE] @ shift)
            shifts.append(shift)
            covariances.append(covariance)
            gains.append(covariance @ weighted[:, :POSE].T)
            likelihoods.append(-0.5 * (log_determinant + chi_square + np.linalg.slogdet(normal)[1]))
        logs = np.array(likelihoods)
        weights = np.exp(logs + self.log_prior - (logs + self.log_prior).max())
        return PoseMixture(
            weights / weights.sum(), np.array(shifts), np.array(covariances), np.array(gains), logs
        )
