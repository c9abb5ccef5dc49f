"""Hypotheses about an arm: size of its errors by those stated, and scatter beyond its model.

The arm's record states how large its errors are; a particular arm has smaller or larger ones, and some that
its model lacks. A hypothesis is a share of the stated sizes, and a scatter from pose to pose. With it the
sources of error at the looks of a case, and their covariance, are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from procedures.registration.error_sources import LACKING
from procedures.registration.target_prediction import AXES, IndependentErrors, SharedErrors
from ronna_hw.arrays import Array

Source = SharedErrors | IndependentErrors

# Share of the stated sizes, with a log-normal prior: two thirds of all arms are within a factor of two (U).
SHARES = tuple(2.0 ** (step / 2.0) for step in range(-3, 5))  # 0.35 to 4
SHARE_SD = math.log(2.0)
# Scatter per axis from pose to pose beyond the model, and its prior: more often none than any (U).
SCATTERS_MM = {0.0: 0.6, 0.03: 0.2, 0.06: 0.12, 0.12: 0.06, 0.24: 0.02}


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


def share_by_sphere(source: IndependentErrors, spheres: Sequence[int]) -> SharedErrors:
    """Return a source whose errors belong to the spheres, one error for all looks (m,) at a sphere."""
    places = np.asarray(spheres)
    columns = []
    for sphere in dict.fromkeys(spheres):
        sizes, axes = np.linalg.eigh(source.at_spheres_mm2[np.argmax(places == sphere)])
        root = axes * np.sqrt(np.maximum(sizes, 0.0))  # an error may be nothing
        columns.append((places == sphere)[:, None, None] * root)
    return SharedErrors(source.source, np.concatenate(columns, axis=2), np.zeros((AXES, AXES * len(columns))))


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


def covariance_with_target(sources: Sequence[Source]) -> Array:
    """Return the covariance (3m, 3) mm2 of all looks with the target."""
    looks = _count_looks(sources[0])
    covariance = np.zeros((AXES * looks, AXES))
    for one in sources:
        if isinstance(one, SharedErrors):
            covariance += one.at_spheres_mm.reshape(AXES * looks, -1) @ one.at_target_mm.T
    return covariance


def covariance_at_target(sources: Sequence[Source]) -> Array:
    """Return the covariance (3, 3) mm2 of the target by these sources."""
    covariance = np.zeros((AXES, AXES))
    for one in sources:
        if isinstance(one, SharedErrors):
            covariance += one.at_target_mm @ one.at_target_mm.T
        else:
            covariance += one.at_target_mm2
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
