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
# Beside spheres: how many times larger the errors of the skin are than the skin itself shows, and how likely
# that is. Source: the kinds of skin that judged first, on 10 heads with one to three screws.
BESIDE_SPHERES = ((UNMODELLED, 0.7), (3.0, 0.3))
AS_SHOWN = ((1.0, 1.0),)
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

    Rotation vector about a centre, rad, and translation, mm. Each component is a hypothesis of the model, its
    number in `hypothesis` (c,), with a region of skin that moved besides by `moved_mm` (c,), its number in
    `region` (c,); region 0 is none.
    """

    weights: Array
    shifts: Array
    covariances: Array
    hypothesis: NDArray[np.int64]
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
            self.hypothesis[kept],
            self.region[kept],
            self.moved_mm[kept],
        )


@dataclass(frozen=True, eq=False)
class MisfitModel:
    """Covariance of the residuals of n points under each hypothesis, factored once.

    A rigid movement leaves the distances of the points, so the factors serve all its steps. Skin that is off
    as a whole does not show it: it moves the pose. Only `known` residuals beside it tell, so a hypothesis
    says besides how many times larger than shown the errors of the skin are, its `excess`.
    """

    misfits: tuple[Misfit, ...]  # (h,)
    excess: Array  # (h,)
    log_prior: Array  # (h,)
    factors: tuple[tuple[Array, bool], ...]
    log_determinants: Array  # (h,)
    points: int  # first rows of the residuals; the others are known ones

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
        All misfits are equally likely without a `prior`. `known_mm2` (q, q) is the covariance of
        further residuals, the last rows of `shared_mm`, which have nothing of the misfit.
        """
        count, distances_mm = len(points_mm), cdist(points_mm, points_mm)
        common, beside = level_mm @ level_mm.T, shared_mm @ shared_mm.T
        common[np.diag_indices(count)] += noise_mm2 + LEAST_NOISE_MM**2
        beside[count:, count:] += known_mm2
        cosines, units, factors = normals @ normals.T, dict[Misfit, Array](), []
        prior = np.full(len(misfits), 1.0 / len(misfits)) if prior is None else prior
        stated = list(
            product(zip(misfits, prior, strict=True), BESIDE_SPHERES if known_mm2.size else AS_SHOWN)
        )
        for (one, _), (excess, _) in stated:
            kind = replace(one, size_mm=1.0)
            if kind not in units:
                units[kind] = kind.covariance_mm2(distances_mm, cosines)
            covariance = beside.copy()
            covariance[:count, :count] += excess**2 * (common + one.size_mm**2 * units[kind])
            factors.append(cho_factor(covariance, lower=True, check_finite=False))
        return cls(
            tuple(one for (one, _), _ in stated),
            np.array([excess for _, (excess, _) in stated]),
            np.log([likely * chance for (_, likely), (_, chance) in stated]),
            tuple(factors),
            np.array([2.0 * np.log(np.diagonal(factor)).sum() for factor, _ in factors]),
            count,
        )

    def some(self, is_chosen: Callable[[Misfit], bool]) -> MisfitModel:
        """Return the model of some misfits alone."""
        rows = [row for row, one in enumerate(self.misfits) if is_chosen(one)]
        return MisfitModel(
            tuple(self.misfits[row] for row in rows),
            self.excess[rows],
            self.log_prior[rows],
            tuple(self.factors[row] for row in rows),
            self.log_determinants[rows],
            self.points,
        )

    def adjust(self, jacobian: Array, residuals_mm: Array) -> PoseMixture:
        """Find the shift that removes residuals (n,), which grow by `jacobian` (n, 6) per unit of shift."""
        return Adjustment.of(self, jacobian).step(residuals_mm)


class Whitened(NamedTuple):
    """Rows of an adjustment under one hypothesis, all of it that does not depend on the residuals."""

    pose: Array  # whitened Jacobian (n, 6)
    skin: Array  # whitened regions (n, g), without what a movement does
    by_pose: Array  # (6, n) shift by whitened residuals
    by_skin: Array  # (6, g) shift by a region's way
    spread: Array  # (g,) precision of that way, its prior counted in
    covariance: Array  # (6, 6) of the shift without a region

    @classmethod
    def of(cls, columns: Array) -> Self:
        """Prepare whitened columns (n, 6 + g) of the pose and the regions."""
        pose, skin = columns[:, :POSE], columns[:, POSE:]
        covariance = np.linalg.inv(pose.T @ pose + np.diag(POSE_SD**-2))
        by_pose = covariance @ pose.T
        by_skin = by_pose @ skin
        left = skin - pose @ by_skin  # of a region's way, what no movement explains
        spread = 1.0 + np.einsum("ng,ng->g", skin, left)
        return cls(pose, left, by_pose, by_skin, np.asarray(spread), np.asarray(covariance))

    def ways(self, residuals: Array) -> Array:
        """Return the way (g,) of each region by whitened residuals (n,)."""
        return np.asarray(self.skin.T @ residuals / self.spread)

    def unexplained(self, residuals: Array) -> Array:
        """Return the sum of squares (g,) that pose and region leave of whitened residuals (n,)."""
        without = residuals @ (residuals - self.pose @ (self.by_pose @ residuals))
        return np.asarray(without - self.ways(residuals) ** 2 * self.spread)


class Hypothesis(NamedTuple):
    """Hypothesis of a model, prepared for the residuals of several steps."""

    factor: Array
    rows: Whitened
    points: Whitened | None  # the points alone, where other rows tell an excess
    excess: float
    log_weight: Array  # (g,)

    def log_evidence(self, whitened: Array) -> Array:
        """Return the logarithm of the evidence (g,) by whitened residuals (n,).

        By an excess k the points move the pose less. That they fit k times better than it says is none of
        their business: their own evidence is that without an excess, p(points | 1) p(others | points, k).
        """
        unexplained = self.rows.unexplained(whitened)
        if self.points is not None:
            own = self.points.unexplained(whitened[: len(self.points.pose)])
            unexplained = unexplained + (self.excess**2 - 1.0) * own
        return np.asarray(self.log_weight - 0.5 * unexplained)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Adjustment of a pose under all hypotheses, prepared for residuals of several steps.

    Each of the regions (n, g) may have moved by an unknown way, at most one of them: which one is part of the
    mixture. A region is how far each residual grows by a unit of its way.
    """

    hypotheses: tuple[Hypothesis, ...]
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
            moved = np.pad(CHANGED_MM * regions, ((0, len(jacobian) - len(regions)), (1, 0)))
            each = CHANGED_SHARE / max(of_regions, regions.shape[1])
            chances = np.append(1.0 - CHANGED_SHARE, np.full(regions.shape[1], each))
        hypotheses, covariances = [], []
        for (factor, _), determinant, prior, excess in zip(
            model.factors, model.log_determinants, model.log_prior, model.excess.tolist(), strict=True
        ):
            columns = np.column_stack([jacobian, excess * moved])
            half = solve_triangular(factor, columns, lower=True, check_finite=False)
            rows = Whitened.of(half)
            points = Whitened.of(half[: model.points]) if len(half) > model.points else None
            log = determinant - np.linalg.slogdet(rows.covariance)[1] + np.log(rows.spread)
            log -= 2.0 * (model.points - POSE) * np.log(excess)
            weight = prior + np.log(chances) - 0.5 * log
            hypotheses.append(Hypothesis(factor, rows, points, excess, weight))
            by_region = np.einsum("ig,jg,g->gij", rows.by_skin, rows.by_skin, 1.0 / rows.spread)
            covariances.append(rows.covariance + by_region)
        return cls(tuple(hypotheses), np.concatenate(covariances))

    def step(self, residuals_mm: Array) -> PoseMixture:
        """Find the shift that removes residuals (n,)."""
        logs, shifts, ways = [], [], []
        for one in self.hypotheses:
            half = solve_triangular(one.factor, residuals_mm, lower=True, check_finite=False)
            way = one.rows.ways(half)
            logs.append(one.log_evidence(half))
            shifts.append((one.rows.by_skin * way - (one.rows.by_pose @ half)[:, None]).T)
            ways.append(one.excess * CHANGED_MM * way)
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
        for number in np.unique(mixture.hypothesis):
            one, chosen = self.hypotheses[number], mixture.hypothesis == number
            rows, region = one.rows, mixture.region[chosen]
            left = rows.by_pose - np.einsum(
                "ig,ng->gin", (rows.by_skin / rows.spread)[:, region], rows.skin[:, region]
            )
            flat = left.reshape(-1, left.shape[2]).T
            found[chosen] = solve_triangular(
                one.factor, flat, lower=True, trans=1, check_finite=False
            ).T.reshape(left.shape)
        return found
