"""Registration together with the errors of the arm that measures: one adjustment of all looks of a case.

A look at a sphere of known place says something about the arm in that pose. With `y` the residuals of all
looks from any nearby pose of the head, `d` a small change of that pose and `u` the errors of arm and spheres,

    y = A d - S u - e,        error at a target = (S_t - W S) u + e_t - W e    for a correction by W y

in the notation of `target_prediction`. W is the best linear unbiased one: W A = A_t, and least variance at
this very target. It is universal kriging with the arm's own error columns as covariance function (Matheron
1969; Rasmussen and Williams, Gaussian processes for machine learning, 2006, section 2.7).

The arm's record states how large its errors are; a particular arm has smaller or larger ones, and some that
its model lacks. Both are hypotheses: a share of the stated sizes, and a scatter from pose to pose. Each has
the likelihood of the residuals under it (restricted: the pose is integrated out). Correction and covariance
are means over all hypotheses, and the covariance includes that their corrections differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import (
    AXES,
    IndependentErrors,
    ResidualCheck,
    SharedErrors,
    TargetPrediction,
    UnnoticedPoint,
    find_worst_displacement,
    predict_by_influence,
)
from ronna_hw.arrays import Array

Source = SharedErrors | IndependentErrors

LACKING = "effects that the arm's model lacks"
SIZES = "sizes of the arm's errors"

# Share of the stated sizes, with a log-normal prior: two thirds of all arms are within a factor of two (U).
SHARES = tuple(2.0 ** (step / 2.0) for step in range(-3, 5))  # 0.35 to 4
SHARE_SD = math.log(2.0)
# Scatter per axis from pose to pose beyond the model, and its prior: more often none than any (U).
SCATTERS_MM = {0.0: 0.6, 0.03: 0.2, 0.06: 0.12, 0.12: 0.06, 0.24: 0.02}


@dataclass(frozen=True)
class Looks:
    """Looks at spheres: residuals (m, 3) mm from a nearby pose of the head, points (m, 3) mm there, errors.

    `arm` are the sources that scale with the size of the arm's errors, `others` all the rest. Errors of a
    sphere that several looks share are `SharedErrors`, see `share_by_sphere`.
    """

    residuals_mm: Array
    points_mm: Array
    arm: Sequence[Source]
    others: Sequence[Source]


def share_by_sphere(source: IndependentErrors, spheres: Sequence[int]) -> SharedErrors:
    """Return a source whose errors belong to the spheres, one error for all looks (m,) at a sphere."""
    places = np.asarray(spheres)
    columns = []
    for sphere in dict.fromkeys(spheres):
        sizes, axes = np.linalg.eigh(source.at_spheres_mm2[np.argmax(places == sphere)])
        root = axes * np.sqrt(np.maximum(sizes, 0.0))  # an error may be nothing
        columns.append((places == sphere)[:, None, None] * root)
    return SharedErrors(source.source, np.concatenate(columns, axis=2), np.zeros((AXES, AXES * len(columns))))


@dataclass(frozen=True)
class Hypothesis:
    """Size of the arm's errors as a share of the stated ones, and scatter per axis beyond its model in mm."""

    share: float
    scatter_mm: float

    def sources(self, arm: Sequence[Source], others: Sequence[Source]) -> list[Source]:
        """List all sources under this hypothesis."""
        looks = _count_looks((*arm, *others)[0])
        variance = np.eye(AXES) * self.scatter_mm**2
        lacking = IndependentErrors(LACKING, np.tile(variance, (looks, 1, 1)), variance)
        return [*(_scaled(one, self.share) for one in arm), *others, lacking]


# Largest size and scatter with which an arm is accepted: larger ones would explain a moved sphere.
# Safety against spheres of CT and robot that do not agree. Source: simulated arms.
LARGEST_SHARE, LARGEST_SCATTER_MM = 2.9, 0.06

HYPOTHESES = tuple(Hypothesis(*both) for both in product(SHARES, SCATTERS_MM))
STATED = Hypothesis(1.0, 0.0)
ACCEPTABLE = np.array(
    [one.share <= LARGEST_SHARE and one.scatter_mm <= LARGEST_SCATTER_MM for one in HYPOTHESES]
)
PRIOR = np.array(
    [
        -0.5 * (math.log(one.share) / SHARE_SD) ** 2 + math.log(SCATTERS_MM[one.scatter_mm])
        for one in HYPOTHESES
    ]
)


@dataclass(frozen=True)
class LearnedTarget:
    """Correction (3,) mm of the commanded place of a target, from its place by `from_pose`, and its error."""

    shift_mm: Array
    prediction: TargetPrediction


@dataclass(frozen=True, eq=False)
class ArmLearning:
    """Adjustment of all looks under each hypothesis, and the probability (h,) of each."""

    looks: Looks
    probabilities: Array
    chi_squares: Array  # (h,) of the residuals, 3m - 6 degrees of freedom
    informations: Array  # (h, 3m, 3m) of the looks
    weights: Array  # (h, 3m, 3m) the same of the residuals, excluding what a pose explains

    @classmethod
    def of(cls, looks: Looks) -> Self:
        """Adjust at least three looks at different spheres."""
        residuals, pose = looks.residuals_mm.reshape(-1), _pose_columns(looks.points_mm)
        evidence, chi_squares, informations, weights = [], [], [], []
        for one in HYPOTHESES:
            covariance = covariance_of(one.sources(looks.arm, looks.others))
            information = np.linalg.inv(covariance)
            normal = pose.T @ information @ pose
            weight = information - information @ pose @ np.linalg.solve(normal, pose.T @ information)
            chi_square = float(residuals @ weight @ residuals)
            spread = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1]
            evidence.append(-0.5 * (spread + chi_square))
            chi_squares.append(chi_square)
            informations.append(information)
            weights.append(weight)
        odds = np.array(evidence) + PRIOR
        probabilities = np.exp(odds - odds.max())
        return cls(
            looks,
            probabilities / probabilities.sum(),
            np.array(chi_squares),
            np.array(informations),
            np.array(weights),
        )

    @property
    def share(self) -> float:
        """Expected size of the arm's errors as a share of the stated ones."""
        return float(self.probabilities @ [one.share for one in HYPOTHESES])

    @property
    def scatter_mm(self) -> float:
        """Expected scatter per axis of the arm beyond its model."""
        return float(self.probabilities @ [one.scatter_mm for one in HYPOTHESES])

    @cached_property
    def acceptable(self) -> ResidualCheck:
        """Residual under the most probable hypothesis that an arm is accepted with, for the gate."""
        best = int(np.where(ACCEPTABLE, self.probabilities, -1.0).argmax())
        return ResidualCheck(float(self.chi_squares[best]), self.looks.residuals_mm.size - 6)

    @cached_property
    def residual(self) -> ResidualCheck:
        """Residual under the most probable hypothesis."""
        best = int(self.probabilities.argmax())
        return ResidualCheck(float(self.chi_squares[best]), self.looks.residuals_mm.size - 6)

    def spheres_mm(self, rows: Sequence[Sequence[int]]) -> tuple[Array, Array]:
        """Return the true place (n, 3) mm of each sphere by its looks, and its covariance (n, 3, 3).

        `rows` are the looks at each sphere. The covariance is that of arm and looks, with
        the pose of the head given.
        """
        count, looks = len(rows), len(self.looks.points_mm)
        mean = np.zeros((count, looks))
        for number, own in enumerate(rows):
            mean[number, list(own)] = 1.0 / len(own)
        average = np.kron(mean, np.eye(AXES))
        looked = (self.looks.residuals_mm + self.looks.points_mm).reshape(-1)
        residuals, shared = self.looks.residuals_mm.reshape(-1), covariance_of(self.looks.arm)
        apart = covariance_of([one for one in self.looks.others if isinstance(one, IndependentErrors)])
        place, covariance = np.zeros(AXES * count), np.zeros((AXES * count, AXES * count))
        found = (HYPOTHESES, self.probabilities, self.informations, self.weights)
        for one, probability, information, weight in zip(*found, strict=True):
            arm = one.share**2 * shared
            lacking = one.scatter_mm**2 * np.eye(AXES * looks)
            place += probability * (average @ (looked - arm @ (weight @ residuals)))
            remaining = arm - arm @ information @ arm + apart + lacking
            covariance += probability * (average @ remaining @ average.T)
        blocks = covariance.reshape(count, AXES, count, AXES)
        own_blocks = blocks[np.arange(count), :, np.arange(count)]
        return place.reshape(-1, AXES), np.asarray(0.5 * (own_blocks + own_blocks.transpose(0, 2, 1)))

    def find_unnoticed(
        self,
        rows: Sequence[Sequence[int]],
        target_mm: Array,
        sources: Sequence[Source],
        limit: float,
        most_mm: float,
    ) -> UnnoticedPoint:
        """Find the sphere whose displacement moves a target (3,) mm furthest with chi-square in its limit.

        `rows` are the looks at each sphere, `sources` all errors under the stated sizes, `most_mm` bounds the
        displacement. A moved sphere makes large errors of the arm more probable, so chi-square is that of the
        largest with which an arm is accepted. See `target_prediction.find_unnoticed_point`.
        """
        looks, widest = len(self.looks.points_mm), int(np.flatnonzero(ACCEPTABLE)[-1])
        weight = self.weights[widest].reshape(looks, AXES, looks, AXES)
        influence = best_influence(self.looks.points_mm, target_mm, sources)
        return find_worst_displacement(
            np.array([weight[list(own)][:, :, list(own)].sum(axis=(0, 2)) for own in rows]),
            np.array([influence[list(own)].sum(axis=0) for own in rows]),
            max(limit - float(self.chi_squares[widest]), 0.0),
            most_mm,
        )

    def at_target(self, target_mm: Array, arm: Sequence[Source], others: Sequence[Source]) -> LearnedTarget:
        """Correct and predict a target (3,) mm, given by the pose that the residuals were taken from.

        The sources are those of the looks, with what they displace at this target.
        """
        residuals, points = self.looks.residuals_mm.reshape(-1), self.looks.points_mm
        shifts, parts = [], []
        for one in HYPOTHESES:
            sources = one.sources(arm, others)
            influence = best_influence(points, target_mm, sources)
            shifts.append(_flat(influence) @ residuals)
            parts.append(predict_by_influence(influence, sources))
        shift = self.probabilities @ np.array(shifts)
        apart = np.array(shifts) - shift
        return LearnedTarget(
            shift, _mean_prediction(self.probabilities, parts, apart, self.residual.widening)
        )


def predict_before_looks(
    points_mm: Array, target_mm: Array, arm: Sequence[Source], others: Sequence[Source]
) -> TargetPrediction:
    """Predict a target (3,) mm from looks at points (m, 3) mm that are still to come: by the prior alone."""
    every = [one.sources(arm, others) for one in HYPOTHESES]
    predictions = [predict_by_influence(best_influence(points_mm, target_mm, one), one) for one in every]
    probabilities = np.exp(PRIOR - PRIOR.max())
    nothing = np.zeros((len(HYPOTHESES), AXES))
    return _mean_prediction(probabilities / probabilities.sum(), predictions, nothing, 1.0)


def best_influence(points_mm: Array, target_mm: Array, sources: Sequence[Source]) -> Array:
    """Return the influence (m, 3, 3) of looks at points (m, 3) mm that predicts the target (3,) mm best."""
    pose, centre = _pose_columns(points_mm), points_mm.mean(axis=0)
    information = np.linalg.inv(covariance_of(sources))
    common = _covariance_with_target(sources).T @ information
    at_target = pose_jacobian(target_mm, centre)
    normal = pose.T @ information @ pose
    missing = np.linalg.solve(normal, (at_target - common @ pose).T).T
    flat = common + missing @ pose.T @ information
    return np.asarray(flat.reshape(AXES, -1, AXES).transpose(1, 0, 2))


def _mean_prediction(
    probabilities: Array, predictions: Sequence[TargetPrediction], apart_mm: Array, widening: float
) -> TargetPrediction:
    parts: dict[str, Array] = {}
    for probability, one in zip(probabilities, predictions, strict=True):
        for name, part in one.by_source_mm2.items():
            parts[name] = parts.get(name, np.zeros((AXES, AXES))) + probability * part
    parts[SIZES] = np.einsum("h,hi,hj->ij", probabilities, apart_mm, apart_mm)
    tested = frozenset[str]().union(*(one.at_spheres for one in predictions)) | {SIZES}
    return replace(predictions[0], by_source_mm2=parts, at_spheres=tested, widening=widening)


def _pose_columns(points_mm: Array) -> Array:
    return pose_jacobian(points_mm, points_mm.mean(axis=0)).reshape(-1, 6)


def _flat(influence: Array) -> Array:
    """Return an influence (m, 3, 3) as a matrix (3, 3m)."""
    return influence.transpose(1, 0, 2).reshape(AXES, -1)


def covariance_of(sources: Sequence[Source]) -> Array:
    """Return the covariance (3m, 3m) mm2 of all looks by these sources, at least one."""
    looks = _count_looks(sources[0])
    covariance = np.zeros((AXES * looks, AXES * looks))
    for one in sources:
        if isinstance(one, SharedErrors):
            columns = one.at_spheres_mm.reshape(AXES * looks, -1)
            covariance += columns @ columns.T
        else:
            covariance += block_diag(*one.at_spheres_mm2)
    return covariance


def _covariance_with_target(sources: Sequence[Source]) -> Array:
    """Return the covariance (3m, 3) mm2 of all looks with the target."""
    looks = _count_looks(sources[0])
    covariance = np.zeros((AXES * looks, AXES))
    for one in sources:
        if isinstance(one, SharedErrors):
            covariance += one.at_spheres_mm.reshape(AXES * looks, -1) @ one.at_target_mm.T
    return covariance


def _count_looks(source: Source) -> int:
    return len(source.at_spheres_mm if isinstance(source, SharedErrors) else source.at_spheres_mm2)


def _scaled(source: Source, share: float) -> Source:
    if isinstance(source, SharedErrors):
        return replace(
            source, at_spheres_mm=share * source.at_spheres_mm, at_target_mm=share * source.at_target_mm
        )
    return replace(
        source, at_spheres_mm2=share**2 * source.at_spheres_mm2, at_target_mm2=share**2 * source.at_target_mm2
    )


def at_looks(sources: Sequence[Source], rows: Sequence[int]) -> list[Source]:
    """Return the sources at some of the looks only."""
    kept = list(rows)
    return [
        replace(one, at_spheres_mm=one.at_spheres_mm[kept])
        if isinstance(one, SharedErrors)
        else replace(one, at_spheres_mm2=one.at_spheres_mm2[kept])
        for one in sources
    ]
