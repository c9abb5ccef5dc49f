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
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, solve_triangular
from scipy.spatial.distance import cdist

from ronna_hw.arrays import Array

POSE = 6  # unknowns of a pose
LEAST_NOISE_MM = 0.03  # of a surface by grey values, from point to point (U)
CHANGED_MM = 1.0  # way of a region of skin that moved by itself, standard deviation (U)
CHANGED_SHARE = 0.9  # of all scans have such a region (U)
NOTHING_KNOWN = np.empty((0, 0))
# Of the pose's error beyond the hypotheses, standard deviation. Source: development skins of the study, on
# which 90 to 91 % of the targets were within the 95 % limit without it.
UNMODELLED = 1.2
NEGLIGIBLE = 5e-4  # weight of the components that are left out in the end
POSE_SD = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])  # rad and mm: a turn that nothing shows stays finite


class Roughness(StrEnum):
    """Kinds of correlation by distance: Matérn's with smoothness one half, three and five halves."""

    ROUGH = "Matérn 1/2"
    SMOOTH = "Matérn 3/2"
    SMOOTHER = "Matérn 5/2"


_CORRELATIONS: dict[Roughness, Callable[[Array], Array]] = {
    Roughness.ROUGH: lambda ratio: np.exp(-ratio),
    Roughness.SMOOTH: lambda ratio: (1.0 + 3.0**0.5 * ratio) * np.exp(-(3.0**0.5) * ratio),
    Roughness.SMOOTHER: lambda ratio: (
        (1.0 + 5.0**0.5 * ratio + 5.0 / 3.0 * ratio**2) * np.exp(-(5.0**0.5) * ratio)
    ),
}


@dataclass(frozen=True)
class Misfit:
    """Hypothesis: standard deviation along the normal, correlation length, and kind of correlation.

    Skin swells and is pressed along its normal. Where `is_sagging` it moved as one in some direction, as soft
    tissue hangs or slides: what shows of that is its part along the normal.
    """

    size_mm: float
    length_mm: float
    roughness: Roughness
    is_sagging: bool = False

    def covariance_mm2(self, distances_mm: Array, cosines: Array) -> Array:
        """Return the covariance of points at these distances, whose normals have these cosines."""
        alike = _CORRELATIONS[self.roughness](distances_mm / self.length_mm)
        return np.asarray(self.size_mm**2 * (alike * cosines if self.is_sagging else alike))


SIZES_MM = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
# The longest are those of a head that swells as a whole: nearly a movement, so that little of it shows.
LENGTHS_MM = {
    Roughness.ROUGH: (15.0, 40.0, 100.0),
    Roughness.SMOOTH: (10.0, 20.0, 40.0),
    Roughness.SMOOTHER: (60.0, 150.0),
}
SAGGING_MM = (40.0, 120.0)
KINDS = (
    *((kind, length_mm, False) for kind, lengths_mm in LENGTHS_MM.items() for length_mm in lengths_mm),
    *((Roughness.SMOOTHER, length_mm, True) for length_mm in SAGGING_MM),
)
MISFITS = tuple(
    Misfit(size_mm, length_mm, kind, is_sagging)
    for (kind, length_mm, is_sagging), size_mm in product(KINDS, SIZES_MM)
)


@dataclass(frozen=True, eq=False)
class PoseMixture:
    """Small movement of a scan as a mixture: weights (c,), shifts (c, 6) and covariances (c, 6, 6).

    Rotation vector about a centre, rad, and translation, mm. Each component is a hypothesis about the misfit,
    its number in `misfit` (c,), with a region of skin that moved besides by `moved_mm` (c,), its number in
    `region` (c,); region 0 is none.
    """

    weights: Array
    shifts: Array
    covariances: Array
    misfit: NDArray[np.int64]
    region: NDArray[np.int64]
    moved_mm: Array

    @property
    def mean(self) -> Array:
        """Expected shift (6,)."""
        return np.asarray(self.weights @ self.shifts)

    def likely(self) -> PoseMixture:
        """Return the mixture without the components that together weigh next to nothing."""
        order = np.argsort(-self.weights, kind="stable")
        kept = np.sort(order[: int(np.searchsorted(np.cumsum(self.weights[order]), 1.0 - NEGLIGIBLE)) + 1])
        return PoseMixture(
            self.weights[kept] / self.weights[kept].sum(),
            self.shifts[kept],
            self.covariances[kept],
            self.misfit[kept],
            self.region[kept],
            self.moved_mm[kept],
        )


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
        normals: Array,
        noise_mm2: Array,
        shared_mm: Array,
        level_mm: Array,
        misfits: Sequence[Misfit] = MISFITS,
        prior: Array | None = None,
        known_mm2: Array = NOTHING_KNOWN,
    ) -> Self:
        """Factor the covariances for points (n, 3) with noise (n,) along their normals (n, 3), in one frame.

        `shared_mm` (n, k) is the displacement along the normals by further errors of one standard deviation,
        `level_mm` (n, l) by those of the surface's level in the CT.
        All hypotheses are equally likely without a `prior` (h,). `known_mm2` (q, q) is the covariance of
        further residuals, the last rows of `shared_mm`, which have nothing of the misfit.
        """
        count, distances_mm = len(points_mm), cdist(points_mm, points_mm)
        common = shared_mm @ shared_mm.T
        common[:count, :count] += level_mm @ level_mm.T
        common[np.diag_indices(count)] += noise_mm2 + LEAST_NOISE_MM**2
        common[count:, count:] += known_mm2
        cosines, units, factors = normals @ normals.T, dict[Misfit, Array](), []
        for one in misfits:
            kind = replace(one, size_mm=1.0)
            if kind not in units:
                units[kind] = kind.covariance_mm2(distances_mm, cosines)
            covariance = common.copy()
            covariance[:count, :count] += one.size_mm**2 * units[kind]
            factors.append(cho_factor(covariance, lower=True, check_finite=False))
        logs = np.array([2.0 * np.log(np.diagonal(factor)).sum() for factor, _ in factors])
        equal = np.full(len(misfits), 1.0 / len(misfits))
        return cls(tuple(misfits), np.log(equal if prior is None else prior), tuple(factors), logs)

    def some(self, is_chosen: Callable[[Misfit], bool]) -> MisfitModel:
        """Return the model of some hypotheses alone."""
        rows = [row for row, one in enumerate(self.misfits) if is_chosen(one)]
        return MisfitModel(
            tuple(self.misfits[row] for row in rows),
            self.log_prior[rows],
            tuple(self.factors[row] for row in rows),
            self.log_determinants[rows],
        )

    def adjust(self, jacobian: Array, residuals_mm: Array) -> PoseMixture:
        """Find the shift that removes residuals (n,), which grow by `jacobian` (n, 6) per unit of shift."""
        return Adjustment.of(self, jacobian).step(residuals_mm)


class _Whitened(NamedTuple):
    """One hypothesis of an adjustment, all of it that does not depend on the residuals."""

    factor: Array
    pose: Array  # whitened Jacobian (n, 6)
    skin: Array  # whitened regions (n, g), without what a movement does
    by_pose: Array  # (6, n) shift by whitened residuals
    by_skin: Array  # (6, g) shift by a region's way
    spread: Array  # (g,) precision of that way, its prior counted in
    log_weight: Array  # (g,)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Adjustment of a pose under all hypotheses, prepared for residuals of several steps.

    Each of the regions (n, g) may have moved by an unknown way, at most one of them: which one is part of the
    mixture. A region is how far each residual grows by a unit of its way.
    """

    hypotheses: tuple[_Whitened, ...]
    covariances: Array

    @classmethod
    def of(
        cls, model: MisfitModel, jacobian: Array, regions: Array | None = None, of_regions: int = 0
    ) -> Self:
        """Prepare for a `jacobian` (n, 6) of the residuals.

        The regions may be those that are left of more, `of_regions`, that are equally likely beforehand.
        """
        moved, chances = np.zeros((len(jacobian), 1)), np.ones(1)
        if regions is not None and regions.shape[1]:
            beside = len(jacobian) - len(regions)  # residuals that are not of the skin
            moved = np.pad(CHANGED_MM * regions, ((0, beside), (1, 0)))
            each = CHANGED_SHARE / max(of_regions, regions.shape[1])
            chances = np.append(1.0 - CHANGED_SHARE, np.full(regions.shape[1], each))
        hypotheses, covariances = [], []
        columns = np.column_stack([jacobian, moved])
        for (factor, _), determinant, prior in zip(
            model.factors, model.log_determinants, model.log_prior, strict=True
        ):
            half = solve_triangular(factor, columns, lower=True, check_finite=False)
            pose, skin = half[:, :POSE], half[:, POSE:]
            normal = pose.T @ pose + np.diag(POSE_SD**-2)
            covariance = np.linalg.inv(normal)
            by_pose = covariance @ pose.T
            by_skin = by_pose @ skin
            left = skin - pose @ by_skin  # of a region's way, what no movement explains
            spread = 1.0 + np.einsum("ng,ng->g", skin, left)
            log = determinant + np.linalg.slogdet(normal)[1] + np.log(spread)
            hypotheses.append(
                _Whitened(factor, pose, left, by_pose, by_skin, spread, prior + np.log(chances) - 0.5 * log)
            )
            covariances.append(covariance + np.einsum("ig,jg,g->gij", by_skin, by_skin, 1.0 / spread))
        return cls(tuple(hypotheses), np.concatenate(covariances))

    def step(self, residuals_mm: Array) -> PoseMixture:
        """Find the shift that removes residuals (n,)."""
        logs, shifts, ways = [], [], []
        for one in self.hypotheses:
            half = solve_triangular(one.factor, residuals_mm, lower=True, check_finite=False)
            by_residual = one.by_pose @ half
            way = one.skin.T @ half / one.spread
            unexplained = float(half @ (half - one.pose @ by_residual))
            logs.append(one.log_weight - 0.5 * (unexplained - way**2 * one.spread))
            shifts.append((one.by_skin * way - by_residual[:, None]).T)
            ways.append(CHANGED_MM * way)
        log = np.concatenate(logs)
        weights = np.exp(log - log.max())
        regions = len(ways[0])
        return PoseMixture(
            weights / weights.sum(),
            np.concatenate(shifts),
            self.covariances,
            np.repeat(np.arange(len(self.hypotheses)), regions),
            np.tile(np.arange(regions), len(self.hypotheses)),
            np.concatenate(ways),
        )

    def gains(self, mixture: PoseMixture) -> Array:
        """Return the effect (c, 6, n) of each residual on the shift, without sign, for some components."""
        found = np.empty((len(mixture.weights), POSE, len(self.hypotheses[0].factor)))
        for number in np.unique(mixture.misfit):
            one, rows = self.hypotheses[number], mixture.misfit == number
            region = mixture.region[rows]
            left = one.by_pose - np.einsum(
                "ig,ng->gin", (one.by_skin / one.spread)[:, region], one.skin[:, region]
            )
            flat = left.reshape(-1, left.shape[2]).T
            found[rows] = solve_triangular(
                one.factor, flat, lower=True, trans=1, check_finite=False
            ).T.reshape(left.shape)
        return found
